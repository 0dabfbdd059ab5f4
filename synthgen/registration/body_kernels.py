"""Compiled parts of fitting bodies: derivatives at surface points, closest points, normals.

A body has too many vertices for their whole Jacobian at every step; what a step needs is one row
for each scan point: how the point of the skin that is nearest to it moves along one direction.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

_FAST = {"contract", "reassoc", "nsz"}


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def point_rows(
    triangle: Any, barycentric: Any, direction: Any, rest: Any, ids: Any, weights: Any,
    parents: Any, frames: Any, shift: Any, joints: Any, axes: Any, directions: Any, of_maps: Any,
    dense: Any, dense_directions: Any, start: Any, first: Any, offset: Any, values: Any,
    feature: Any, at: Any, out: Any,
) -> None:  # fmt: skip
    """Differentiate points of the skin along directions: out (m, n), zero on entry.

    triangle, barycentric, direction (m, 3); rest (V, 3): points before skinning, correctives
    included; frames (K, 3, 3), shift (K, 3): maps of rest points; axes (K, 3, 3): world, rows by
    number; directions (V, 3, c) of all coefficients, of_maps (K, 3, c) their share in the maps;
    correctives: columns ``dense`` by vertex (V, 3, nd), the others in runs as in
    ``models.packed.Runs``; feature (K, 3, q): derivatives of pose features.
    at: first columns of shape, pose, translation, expression, and the number of shape columns.
    """
    k, q, c = parents.shape[0], feature.shape[2], directions.shape[2]
    lever, held, h = np.zeros((k, 3)), np.zeros(k), np.zeros(3)
    driven, coefficient = np.zeros(k * q), np.zeros(c)
    touched = np.zeros(k, np.bool_)
    for i in range(triangle.shape[0]):
        row, d = out[i], direction[i]
        coefficient[:] = 0.0
        for corner in range(3):
            b, v = barycentric[i, corner], triangle[i, corner]
            if b == 0.0:
                continue
            _hold(b, ids[v], weights[v], rest[v], d, frames, shift, lever, held, h)
            _add_bases(directions[v], h, coefficient)
            for e in range(dense.shape[0]):
                p = dense_directions[v]
                driven[dense[e]] += h[0] * p[0, e] + h[1] * p[1, e] + h[2] * p[2, e]
                touched[dense[e] // q] = True
            for r in range(start[v], start[v + 1]):
                size = (offset[r + 1] - offset[r]) // 3
                run = values[offset[r] : offset[r + 1]].reshape(3, size)
                _add_bases(run, h, driven[first[r] : first[r] + size])
                for j in range(first[r] // q, (first[r] + size) // q):
                    touched[j] = True
        for j in range(k):
            if held[j] != 0.0:
                for a in range(3):
                    h[a] = held[j] * d[a]
                _add_bases(of_maps[j], h, coefficient)
        for e in range(c):
            row[at[0] + e if e < at[4] else at[3] + e - at[4]] = coefficient[e]
        for a in range(3):
            row[at[2] + a] = d[a]
        _pose_columns(row[at[1] :], d, parents, joints, axes, feature, lever, held, driven, touched)


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _hold(
    b: float, ids: Any, weights: Any, rest: Any, d: Any, frames: Any, shift: Any, lever: Any,
    held: Any, h: Any,
) -> None:  # fmt: skip
    """Give the share b of a vertex to its joints; turn d back to its rest pose, times b -> h."""
    x, y, z = rest[0], rest[1], rest[2]
    h0, h1, h2 = 0.0, 0.0, 0.0
    for s in range(ids.shape[0]):
        w, j = b * weights[s], ids[s]
        if w == 0.0:
            break
        g, t, a = frames[j], shift[j], lever[j]
        held[j] += w
        a[0] += w * (g[0, 0] * x + g[0, 1] * y + g[0, 2] * z + t[0])
        a[1] += w * (g[1, 0] * x + g[1, 1] * y + g[1, 2] * z + t[1])
        a[2] += w * (g[2, 0] * x + g[2, 1] * y + g[2, 2] * z + t[2])
        h0 += w * (d[0] * g[0, 0] + d[1] * g[1, 0] + d[2] * g[2, 0])
        h1 += w * (d[0] * g[0, 1] + d[1] * g[1, 1] + d[2] * g[2, 1])
        h2 += w * (d[0] * g[0, 2] + d[1] * g[1, 2] + d[2] * g[2, 2])
    h[0], h[1], h[2] = h0, h1, h2


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _add_bases(bases: Any, h: Any, out: Any) -> None:
    """Add h (3,) times bases (3, n) to out (n,)."""
    x, y, z = bases[0], bases[1], bases[2]
    for e in range(out.shape[0]):
        out[e] += h[0] * x[e] + h[1] * y[e] + h[2] * z[e]


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _pose_columns(
    row: Any, d: Any, parents: Any, joints: Any, axes: Any, feature: Any, lever: Any, held: Any,
    driven: Any, touched: Any,
) -> None:  # fmt: skip
    """Write the columns of joints that carry or correct a point; clear what was gathered."""
    q = feature.shape[2]
    for j in range(parents.shape[0] - 1, -1, -1):
        w, a = held[j], lever[j]
        if w != 0.0:
            x, y, z = a[0] - w * joints[j, 0], a[1] - w * joints[j, 1], a[2] - w * joints[j, 2]
            n0, n1, n2 = y * d[2] - z * d[1], z * d[0] - x * d[2], x * d[1] - y * d[0]
            for s in range(3):
                u = axes[j, s]
                row[3 * j + s] = u[0] * n0 + u[1] * n1 + u[2] * n2
            p = parents[j]
            if p >= 0:
                held[p] += w
                for s in range(3):
                    lever[p, s] += a[s]
            held[j] = 0.0
            for s in range(3):
                a[s] = 0.0
        if touched[j]:
            for e in range(j * q, j * q + q):
                for s in range(3):
                    row[3 * j + s] += driven[e] * feature[j, s, e - j * q]
                driven[e] = 0.0
            touched[j] = False


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def normal_sums(rows: Any, weight: Any, residual: Any, hessian: Any, gradient: Any) -> None:
    """Add J^T W J (lower triangle) and J^T W r of sparse rows (m, n); zeros cost a look."""
    n = rows.shape[1]
    place, value = np.zeros(n, np.int64), np.zeros(n)
    for i in range(rows.shape[0]):
        w = weight[i]
        if w == 0.0:
            continue
        used = 0
        for a in range(n):
            if rows[i, a] != 0.0:
                place[used], value[used] = a, rows[i, a]
                used += 1
        for s in range(used):
            a, x = place[s], w * value[s]
            gradient[a] += x * residual[i]
            line = hessian[a]
            for t in range(s + 1):
                line[place[t]] += x * value[t]


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def vertex_normals(vertices: Any, faces: Any, normals: Any) -> None:
    """Write unit normals (V, 3), area weighted."""
    normals[:] = 0.0
    for f in range(faces.shape[0]):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        u0, u1, u2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        v0, v1, v2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        x, y, z = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
        for corner in range(3):
            n = normals[faces[f, corner]]
            n[0] += x
            n[1] += y
            n[2] += z
    for v in range(normals.shape[0]):
        n = normals[v]
        length = max(np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]), 1e-12)
        n[0] /= length
        n[1] /= length
        n[2] /= length


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def nearest_on_rings(
    points: Any, near: Any, vertices: Any, faces: Any, first: Any, around: Any, squared: Any,
    face: Any, closest: Any,
) -> None:  # fmt: skip
    """Closest points (m, 3) on the triangles around the vertices near (m, k) each point.

    Triangles around vertex v are ``around[first[v]:first[v + 1]]``.
    """
    q = np.zeros(3)
    for i in range(points.shape[0]):
        squared[i] = np.inf
        for s in range(near.shape[1]):
            v = near[i, s]
            for e in range(first[v], first[v + 1]):
                f = around[e]
                a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
                d = _nearest_on_triangle(points[i], a, b, c, q)
                if d < squared[i]:
                    squared[i], face[i] = d, f
                    closest[i, 0], closest[i, 1], closest[i, 2] = q[0], q[1], q[2]


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _nearest_on_triangle(p: Any, a: Any, b: Any, c: Any, out: Any) -> float:
    """Closest point of a triangle (Ericson, Real-Time Collision Detection, 5.1.5); distance^2."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    uu, uv, vv = (
        ux * ux + uy * uy + uz * uz,
        ux * vx + uy * vy + uz * vz,
        vx * vx + vy * vy + vz * vz,
    )
    d1, d2 = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    d3, d4, d5, d6 = d1 - uu, d2 - uv, d1 - uv, d2 - vv
    s, t = 0.0, 0.0
    if not (d1 <= 0 and d2 <= 0):
        vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
        if d3 >= 0 and d4 <= d3:
            s = 1.0
        elif d6 >= 0 and d5 <= d6:
            t = 1.0
        elif vc <= 0 and d1 >= 0 and d3 <= 0:
            s = d1 / (d1 - d3)
        elif vb <= 0 and d2 >= 0 and d6 <= 0:
            t = d2 / (d2 - d6)
        elif va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
            t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
            s = 1.0 - t
        else:
            scale = 1.0 / (va + vb + vc)
            s, t = vb * scale, vc * scale
    rx, ry, rz = wx - s * ux - t * vx, wy - s * uy - t * vy, wz - s * uz - t * vz
    out[0], out[1], out[2] = p[0] - rx, p[1] - ry, p[2] - rz
    return float(rx * rx + ry * ry + rz * rz)


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def plane_product(
    triangle: Any, barycentric: Any, normal: Any, weight: Any, tangential: float, x: Any, out: Any
) -> None:
    """Add sum_i w_i B_i^T (n_i n_i^T + tangential) B_i x to out (V, 3), B_i x a surface point's."""
    for i in range(triangle.shape[0]):
        t, b, n = triangle[i], barycentric[i], normal[i]
        y0 = b[0] * x[t[0], 0] + b[1] * x[t[1], 0] + b[2] * x[t[2], 0]
        y1 = b[0] * x[t[0], 1] + b[1] * x[t[1], 1] + b[2] * x[t[2], 1]
        y2 = b[0] * x[t[0], 2] + b[1] * x[t[1], 2] + b[2] * x[t[2], 2]
        _pull(t, b, n, weight[i], tangential, y0, y1, y2, out)


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def plane_pull(
    triangle: Any, barycentric: Any, normal: Any, weight: Any, tangential: float, y: Any, out: Any
) -> None:
    """Add sum_i w_i B_i^T (n_i n_i^T + tangential) y_i, y (m, 3), to out (V, 3)."""
    for i in range(triangle.shape[0]):
        _pull(triangle[i], barycentric[i], normal[i], weight[i], tangential, y[i, 0], y[i, 1],
              y[i, 2], out)  # fmt: skip


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _pull(
    t: Any, b: Any, n: Any, w: float, tangential: float, y0: float, y1: float, y2: float, out: Any
) -> None:
    along = w * (n[0] * y0 + n[1] * y1 + n[2] * y2)
    share = w * tangential
    for corner in range(3):
        o = out[t[corner]]
        o[0] += b[corner] * (along * n[0] + share * y0)
        o[1] += b[corner] * (along * n[1] + share * y1)
        o[2] += b[corner] * (along * n[2] + share * y2)


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def plane_blocks(
    triangle: Any, barycentric: Any, normal: Any, weight: Any, tangential: float, blocks: Any
) -> None:
    """Add each vertex's own 3 x 3 block of :func:`plane_product` to blocks (V, 3, 3)."""
    for i in range(triangle.shape[0]):
        n = normal[i]
        for corner in range(3):
            b = barycentric[i, corner]
            w, block = weight[i] * b * b, blocks[triangle[i, corner]]
            for p in range(3):
                for q in range(3):
                    block[p, q] += w * n[p] * n[q]
                block[p, p] += w * tangential
