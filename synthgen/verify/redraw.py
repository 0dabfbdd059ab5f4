"""A view drawn again from its stored parameters by the reference rasteriser."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.corpus.sample import Sample, Subject, View
from synthgen.geometry.cameras import Camera
from synthgen.geometry.raster import rasterise, split
from synthgen.models import pose_surface
from synthgen.scene.instances import objects_of
from synthgen.scene.relief import relief_of
from synthgen.scene.solids import SolidMesh, mesh_of
from synthgen.scene.surface import DrawnSurface
from synthgen.scene.wear import dress

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

# With distortion, triangles are split until they are this small; a table needs nine rounds.
SMALL_PX, MOST_SPLITS = 10.0, 10


@dataclass(frozen=True, eq=False)
class Redrawn:
    """Subjects and things of a view, (H, W, ...).

    ``face`` is -1 off hands; walls and lamps are not drawn.
    """

    instance: Ids
    face: Ids
    barycentric: Array
    depth_z_m: Array


def redraw(sample: Sample, view: View) -> Redrawn:
    """Draw every hand, what is worn and every thing of a view with the z-buffer."""
    camera = sample.spec.scene.cameras[view.meta["view"]]
    shape = (camera.height, camera.width)
    instance, face = np.zeros(shape, np.int64), np.full(shape, -1, np.int64)
    barycentric, depth = np.zeros((*shape, 3)), np.full(shape, np.inf)
    for number, subject in enumerate(sample.subjects, start=1):
        drawn = DrawnSurface.for_model(subject.loaded)
        vertices = drawn.refine(*_surface(subject))
        front = _front_faces(vertices, drawn.refined_faces, camera)
        prim, weights, z = rasterise(vertices, drawn.refined_faces[front], camera)
        nearer = (prim >= 0) & (z < depth)
        instance[nearer], depth[nearer] = number, z[nearer]
        face[nearer], barycentric[nearer] = drawn.parent(front[prim[nearer]], weights[nearer])
    for number, mesh in _others(sample):
        prim, _, z = rasterise(*_small_faces(mesh, camera), camera)
        nearer = (prim >= 0) & (z < depth)
        instance[nearer], depth[nearer], face[nearer] = number, z[nearer], -1
        barycentric[nearer] = 0
    return Redrawn(instance, face, barycentric, np.where(np.isfinite(depth), depth, 0))


def _surface(subject: Subject) -> tuple[NDArray[np.float32], Array | None]:
    s = subject.description
    surface, _ = pose_surface(
        subject.loaded, subject.shape, subject.pose, subject.translation,
        np.array(s.wrist), np.array(s.elbow),
    )  # fmt: skip
    return surface, relief_of(subject.loaded, s.skin, subject.pose)


def _others(sample: Sample) -> list[tuple[int, SolidMesh]]:
    """Return every mesh that is no hand with its instance id, 0 for the background's."""
    scene, found = sample.spec.scene, []
    ids = {(o.subject, o.place): o.instance_id for o in objects_of(scene)}
    for k, subject in enumerate(sample.subjects):
        worn = dress(subject.loaded, subject.description)
        if worn.sleeve is not None:
            found.append((ids[k, -1], worn.sleeve))
        found += [(ids[k, j], band) for j, band in enumerate(worn.bands)]
    found += [(ids.get((-1, j), 0), mesh_of(thing)) for j, thing in enumerate(scene.things)]
    return found


def _small_faces(mesh: SolidMesh, camera: Camera) -> tuple[Array, Ids]:
    """Return the triangles before the camera; small ones where its lens bends lines."""
    if not any(camera.distortion):
        front = _front_faces(mesh.vertices, mesh.triangles, camera)
        return mesh.vertices, mesh.triangles[front]
    corners, small = mesh.vertices[mesh.triangles], []
    for number in range(MOST_SPLITS):
        local = (corners - camera.position) @ camera.T[:3, :3]
        longest = np.linalg.norm(local - np.roll(local, 1, axis=1), axis=2).max(axis=1)
        large = longest * camera.fx > SMALL_PX * np.maximum(local[..., 2].min(axis=1), 0.05)
        large &= number < MOST_SPLITS - 1
        small.append(corners[~large & _inside(local, camera).all(axis=1)])
        vertices, faces = split(*_loose(corners[large & _reaches(local, camera)]))
        corners = vertices[faces]
    return _loose(np.concatenate(small))


def _loose(corners: Array) -> tuple[Array, Ids]:
    """Return triangles (n, 3, 3) as vertices and faces that share none."""
    return corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)


def _front_faces(vertices: Array, faces: Ids, camera: Camera) -> Ids:
    """Faces wholly in front of the camera; an arm may pass behind it, out of the picture."""
    inside = _inside((vertices - camera.position) @ camera.T[:3, :3], camera)
    return np.flatnonzero(inside[faces].all(axis=1))


def _inside(local: Array, camera: Camera) -> NDArray[np.bool_]:
    """Tell which camera-frame points (..., 3) are in front, and where the lens model holds.

    Far outside the frame a distortion folds back into it.
    """
    inside = local[..., 2] > 0.01
    if any(camera.distortion):
        inside &= np.hypot(local[..., 0], local[..., 1]) < _edge(camera) * local[..., 2]
    return np.asarray(inside)


def _reaches(local: Array, camera: Camera) -> NDArray[np.bool_]:
    """Tell which triangles (n, 3, 3) may have a part in the frame."""
    front = (local[..., 2] > 0.01).any(axis=1)
    span = _edge(camera) * np.maximum(local[..., 2].max(axis=1), 0.01)
    low, high = local[..., :2].min(axis=1), local[..., :2].max(axis=1)
    return np.asarray(front & ((low < span[:, None]) & (high > -span[:, None])).all(axis=1))


def _edge(camera: Camera) -> float:
    """Radius, over depth, up to which points are drawn: 1.4 times the frame's corner."""
    return 0.7 * float(np.hypot(camera.width / camera.fx, camera.height / camera.fy))
