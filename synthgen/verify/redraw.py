"""A view drawn again from its stored parameters by the reference rasteriser."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.corpus.sample import Sample, Subject
from synthgen.geometry.cameras import Camera
from synthgen.geometry.raster import pierce, rasterise, split
from synthgen.models import pose_surface
from synthgen.scene.instances import objects_of
from synthgen.scene.relief import relief_of
from synthgen.scene.solids import SolidMesh, mesh_of
from synthgen.scene.surface import DrawnSurface
from synthgen.scene.wear import dress

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
Draw = Callable[..., tuple[Any, Any, Any]]

# With distortion, triangles are split until they are this small; a table needs nine rounds.
SMALL_PX, MOST_SPLITS = 10.0, 10


@dataclass(frozen=True, eq=False)
class Redrawn:
    """Subjects and things of a view, (H, W, ...), or on single rays, (n, ...).

    ``face`` is -1 off hands; walls and lamps are not drawn.
    """

    instance: Ids
    face: Ids
    barycentric: Array
    depth_z_m: Array


def redraw(layered: Sequence[Layer], camera: Camera) -> Redrawn:
    """Draw every hand, what is worn and every thing before a camera with the z-buffer."""
    return _nearest(layered, partial(rasterise, camera=camera), (camera.height, camera.width))


def pierced(layered: Sequence[Layer], camera: Camera, pixels: Array) -> Redrawn:
    """Find what lies on the rays through points (n, 2) of a picture; arrays are (n, ...)."""
    return _nearest(layered, partial(pierce, camera=camera, pixels=pixels), (len(pixels),))


@dataclass(frozen=True, eq=False)
class Layer:
    """One mesh before a camera: its instance, and of a hand the surface that was refined.

    ``front`` are the rows of the surface's refined faces that ``faces`` holds.
    """

    instance: int
    vertices: Array
    faces: Ids
    drawn: DrawnSurface | None = None
    front: Ids | None = None


def layers(sample: Sample, camera: Camera) -> list[Layer]:
    """Return every mesh of a sample: hands, what is worn, things; not walls and lamps."""
    found = []
    for number, subject in enumerate(sample.subjects, start=1):
        drawn = DrawnSurface.for_model(subject.loaded)
        vertices = drawn.refine(*_surface(subject))
        front = _front_faces(vertices, drawn.refined_faces, camera)
        found.append(Layer(number, vertices, drawn.refined_faces[front], drawn, front))
    return found + [Layer(n, *_small_faces(mesh, camera)) for n, mesh in _others(sample)]


def _nearest(layered: Sequence[Layer], draw: Draw, shape: tuple[int, ...]) -> Redrawn:
    instance, face = np.zeros(shape, np.int64), np.full(shape, -1, np.int64)
    barycentric, depth = np.zeros((*shape, 3)), np.full(shape, np.inf)
    for layer in layered:
        if not len(layer.faces):
            continue
        prim, weights, z = draw(layer.vertices, layer.faces)
        nearer = (prim >= 0) & (z < depth)
        instance[nearer], depth[nearer], face[nearer] = layer.instance, z[nearer], -1
        barycentric[nearer] = 0
        if layer.drawn is not None and layer.front is not None:
            own = layer.front[prim[nearer]]
            face[nearer], barycentric[nearer] = layer.drawn.parent(own, weights[nearer])
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
        if not len(corners):  # most things are small, or outside the frame
            break
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
