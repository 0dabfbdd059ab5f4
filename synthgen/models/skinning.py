"""Compiled skinning of rest points; the readable truth is :mod:`synthgen.models.reference`.

A joint's map is kept as sixteen numbers, the four columns (x, y, z, 0) of [A - 1 | t], and blended
as one vector of them: numba's own loops do not become vectors of a known width. Blending
*differences from the identity*, v = p + sum w (A - 1) p, is exact at the zero pose and loses fewer
digits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic, models, register_model

# Numbers of a map.
WIDTH = 16
# Samples that are corrected together: one AVX-512 or two AVX2 registers of float32.
TILE = 16
# Vertices whose corrections are kept until they are added sample by sample.
_BLOCK = 64


class _Map(types.Type):
    """The sixteen numbers of a (blended) map, in one vector."""

    def __init__(self, number: Any) -> None:
        self.number = number
        super().__init__(name=f"Map({number})")


@register_model(_Map)
class _MapModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        number = ir.FloatType() if kind.number == types.float32 else ir.DoubleType()
        super().__init__(manager, kind, ir.VectorType(number, WIDTH))  # type: ignore[no-untyped-call]


def _instructions(generator: Callable[..., Any]) -> Callable[..., Any]:
    """Make a function for the kernels whose instructions are written here."""
    return intrinsic(generator)


def _vector(builder: Any, numbers: list[Any], width: int) -> Any:
    """Return a vector of numbers, one of them repeated where there is only one."""
    index = ir.IntType(32)
    vector = ir.Constant(ir.VectorType(numbers[0].type, width), ir.Undefined)
    for i, number in enumerate(numbers):
        vector = builder.insert_element(vector, number, index(i))
    return vector if len(numbers) > 1 else _picked(builder, vector, [0] * width)


def _picked(builder: Any, vector: Any, places: list[int]) -> Any:
    """Return the numbers of a vector at some places."""
    mask = ir.VectorType(ir.IntType(32), len(places))(places)
    return builder.shuffle_vector(vector, vector, mask)


def _fma(builder: Any, a: Any, b: Any, c: Any) -> Any:
    return builder.fadd(builder.fmul(a, b, flags=["fast"]), c, flags=["fast"])


@_instructions
def _four(_: Any, maps: Any, joints: Any, weights: Any) -> Any:
    """Blend the maps (K, 16) of four joints by four weights."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array, joints, weights = arguments
        data = context.make_array(signature.args[0])(context, builder, array).data
        kind = context.get_value_type(signature.return_type)
        total = kind(None)
        for i in range(4):
            joint = builder.sext(builder.extract_value(joints, i), ir.IntType(64))
            first = builder.gep(data, [builder.mul(joint, joint.type(WIDTH))])
            row = builder.bitcast(first, kind.as_pointer())
            row = builder.load(row, align=signature.args[0].dtype.bitwidth // 8)
            weight = _vector(builder, [builder.extract_value(weights, i)], WIDTH)
            total = _fma(builder, row, weight, total)
        return total

    return _Map(maps.dtype)(maps, joints, weights), generate


@_instructions
def _sum(_: Any, a: Any, b: Any) -> Any:
    """Return the sum of two maps."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fadd(*arguments, flags=["fast"])

    return a(a, b), generate


@_instructions
def _moved(_: Any, a: Any, point: Any, excess: Any, shift: Any) -> Any:
    """Return p + (excess p + a(p)) + shift of a point (x, y, z) and a map."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        blended, point, excess, shift = arguments
        xyz, txyz = ([builder.extract_value(t, i) for i in range(3)] for t in (point, shift))
        moved = _picked(builder, blended, [12, 13, 14, 15])
        for c, number in enumerate(xyz):
            column = _picked(builder, blended, [4 * c, 4 * c + 1, 4 * c + 2, 4 * c + 3])
            moved = _fma(builder, column, _vector(builder, [number], 4), moved)
        p, t = _vector(builder, xyz, 4), _vector(builder, txyz, 4)
        moved = _fma(builder, p, _vector(builder, [excess], 4), moved)
        moved = builder.fadd(builder.fadd(p, moved), t)
        three = [builder.extract_element(moved, ir.IntType(32)(i)) for i in range(3)]
        return context.make_tuple(builder, signature.return_type, three)

    return point(a, point, excess, shift), generate


@njit(cache=True, error_model="numpy", fastmath=True)
def skin(
    points: Any, maps: Any, ids: Any, weights: Any, excess: Any, moved: Any, out: Any
) -> None:  # fmt: skip
    """Blend maps (B, K, 12), move points (B, 3 V) by them and by (B, 3) -> out (B, 3 V).

    Maps are the rows of [A - 1 | t]; ids, weights (V, k) in descending order, k a multiple of
    four: four zeros end them. ``out`` may be ``points``.
    """
    n, n_joints = maps.shape[:2]
    room = np.zeros((2 * n_joints + 1) * WIDTH, out.dtype)
    start = (-room.ctypes.data % 64) // room.itemsize  # a map that straddles cache lines is slow
    A = room[start : start + 2 * n_joints * WIDTH].reshape(2 * n_joints, WIDTH)
    A0, A1 = A[:n_joints], A[n_joints:]
    paired = n - n % 2 if ids.shape[1] == 4 else 0
    for b in range(0, paired, 2):  # two samples share what is read of a vertex
        _columns(maps[b], A0)
        _columns(maps[b + 1], A1)
        p0, o0, t0 = points[b], out[b], (moved[b, 0], moved[b, 1], moved[b, 2])
        p1, o1, t1 = points[b + 1], out[b + 1], (moved[b + 1, 0], moved[b + 1, 1], moved[b + 1, 2])
        for v in range(ids.shape[0]):
            j = ids[v, 0], ids[v, 1], ids[v, 2], ids[v, 3]
            w, e = (weights[v, 0], weights[v, 1], weights[v, 2], weights[v, 3]), excess[v]
            q0 = p0[3 * v], p0[3 * v + 1], p0[3 * v + 2]
            q1 = p1[3 * v], p1[3 * v + 1], p1[3 * v + 2]
            o0[3 * v], o0[3 * v + 1], o0[3 * v + 2] = _moved(_four(A0, j, w), q0, e, t0)
            o1[3 * v], o1[3 * v + 1], o1[3 * v + 2] = _moved(_four(A1, j, w), q1, e, t1)
    for b in range(paired, n):
        _columns(maps[b], A0)
        p, o, t = points[b], out[b], (moved[b, 0], moved[b, 1], moved[b, 2])
        for v in range(ids.shape[0]):
            j = ids[v, 0], ids[v, 1], ids[v, 2], ids[v, 3]
            m = _four(A0, j, (weights[v, 0], weights[v, 1], weights[v, 2], weights[v, 3]))
            for i in range(4, ids.shape[1], 4):
                if weights[v, i] == 0:
                    break
                j = ids[v, i], ids[v, i + 1], ids[v, i + 2], ids[v, i + 3]
                w = weights[v, i], weights[v, i + 1], weights[v, i + 2], weights[v, i + 3]
                m = _sum(m, _four(A0, j, w))
            q = p[3 * v], p[3 * v + 1], p[3 * v + 2]
            o[3 * v], o[3 * v + 1], o[3 * v + 2] = _moved(m, q, excess[v], t)


@njit(cache=True, error_model="numpy", fastmath=True)
def _columns(rows: Any, columns: Any) -> None:
    """Lay maps (K, 12) out by columns (K, 16)."""
    for k in range(rows.shape[0]):
        for c in range(4):
            for a in range(3):
                columns[k, 4 * c + a] = rows[k, 4 * a + c]


@njit(cache=True, error_model="numpy", fastmath=True)
def correct_few(
    features: Any, vertices: Any, start: Any, first: Any, offset: Any, values: Any, points: Any
) -> None:  # fmt: skip
    """Add sparse correctives of features (B, K q) to points (B, 3 V), sample by sample.

    vertices, start, first, offset, values as in ``packed.Runs``.
    """
    for b in range(points.shape[0]):
        p, f = points[b], features[b]
        for v in vertices:
            x, y, z = p[3 * v], p[3 * v + 1], p[3 * v + 2]
            for n in range(start[v], start[v + 1]):
                size = (offset[n + 1] - offset[n]) // 3
                g, o0 = f[first[n] : first[n] + size], offset[n]
                if size == 4:  # one joint's quaternion: a loop would cost more than the sums
                    m = values[o0 : o0 + 12]
                    x += m[0] * g[0] + m[1] * g[1] + m[2] * g[2] + m[3] * g[3]
                    y += m[4] * g[0] + m[5] * g[1] + m[6] * g[2] + m[7] * g[3]
                    z += m[8] * g[0] + m[9] * g[1] + m[10] * g[2] + m[11] * g[3]
                    continue
                mx, my = values[o0 : o0 + size], values[o0 + size : o0 + 2 * size]
                mz = values[o0 + 2 * size : o0 + 3 * size]
                for i in range(size):
                    x += mx[i] * g[i]
                    y += my[i] * g[i]
                    z += mz[i] * g[i]
            p[3 * v], p[3 * v + 1], p[3 * v + 2] = x, y, z


@njit(cache=True, error_model="numpy", fastmath=True)
def correct_many(
    features: Any, vertices: Any, start: Any, first: Any, offset: Any, values: Any, points: Any
) -> None:  # fmt: skip
    """Do as :func:`correct_few`, TILE samples side by side, so that inner loops vectorise."""
    n_samples, n_features = features.shape
    tile = np.zeros(n_features * TILE, points.dtype)
    block = np.empty((_BLOCK, 3 * TILE), points.dtype)
    for b0 in range(0, n_samples, TILE):
        n = min(TILE, n_samples - b0)
        for s in range(n):
            for i in range(n_features):
                tile[i * TILE + s] = features[b0 + s, i]
        for v0 in range(0, vertices.shape[0], _BLOCK):
            some = vertices[v0 : v0 + _BLOCK]
            for i in range(some.shape[0]):
                block[i] = 0
                for r in range(start[some[i]], start[some[i] + 1]):
                    _add_run(tile[first[r] * TILE :], values[offset[r] : offset[r + 1]], block[i])
            for s in range(n):
                p = points[b0 + s]
                for i in range(some.shape[0]):
                    v, q = some[i], block[i]
                    p[3 * v] += q[s]
                    p[3 * v + 1] += q[TILE + s]
                    p[3 * v + 2] += q[2 * TILE + s]


@njit(cache=True, error_model="numpy", fastmath=True)
def _add_run(features: Any, values: Any, p: Any) -> None:
    """Add a run of correctives to points p (3 TILE), four features at a time."""
    size = values.shape[0] // 3
    mx, my, mz = values[:size], values[size : 2 * size], values[2 * size :]
    whole = size - size % 4
    for i in range(0, whole, 4):
        g = features[i * TILE : (i + 4) * TILE]
        x0, x1, x2, x3 = mx[i], mx[i + 1], mx[i + 2], mx[i + 3]
        y0, y1, y2, y3 = my[i], my[i + 1], my[i + 2], my[i + 3]
        z0, z1, z2, z3 = mz[i], mz[i + 1], mz[i + 2], mz[i + 3]
        for s in range(TILE):
            a, b, c, d = g[s], g[TILE + s], g[2 * TILE + s], g[3 * TILE + s]
            p[s] += x0 * a + x1 * b + x2 * c + x3 * d
            p[TILE + s] += y0 * a + y1 * b + y2 * c + y3 * d
            p[2 * TILE + s] += z0 * a + z1 * b + z2 * c + z3 * d
    for i in range(whole, size):
        g = features[i * TILE : (i + 1) * TILE]
        for s in range(TILE):
            p[s] += mx[i] * g[s]
            p[TILE + s] += my[i] * g[s]
            p[2 * TILE + s] += mz[i] * g[s]
