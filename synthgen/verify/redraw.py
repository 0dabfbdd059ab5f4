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


@dataclass(frozen=True, eq=False)
class Redrawn:
    """Subjects and things of a view, (H, W, ...).

    ``face`` is -1 off hands; ``covered`` tells where something that is no hand is nearest, though
    a hand is behind it; walls and lamps are not drawn.
    """

    instance: Ids
    face: Ids
    barycentric: Array
    depth_z_m: Array
    covered: NDArray[np.bool_]


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
    hands = depth.copy()
    for number, mesh in _others(sample):
        prim, _, z = rasterise(*_small_faces(mesh, camera), camera)
        nearer = (prim >= 0) & (z < depth)
        instance[nearer], depth[nearer], face[nearer] = number, z[nearer], -1
        barycentric[nearer] = 0
    return Redrawn(
        instance, face, barycentric, np.where(np.isfinite(depth), depth, 0),
        covered=np.isfinite(hands) & (depth < hands),
    )  # fmt: skip


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
    vertices, faces = mesh.vertices, mesh.triangles
    if any(camera.distortion):
        vertices, faces = split(vertices, faces, 4 if len(faces) < 100 else 1)
    return vertices, faces[_front_faces(vertices, faces, camera)]


def _front_faces(vertices: Array, faces: Ids, camera: Camera) -> Ids:
    """Faces wholly in front of the camera; an arm may pass behind it, out of the picture.

    Far outside the frame a lens model folds back into it, so with distortion faces there go too.
    """
    local = (vertices - camera.position) @ camera.T[:3, :3]
    inside = local[:, 2] > 0.01
    if any(camera.distortion):
        corner = np.hypot(camera.width / camera.fx, camera.height / camera.fy) / 2
        inside &= np.hypot(local[:, 0], local[:, 1]) < 1.4 * corner * local[:, 2]
    return np.flatnonzero(inside[faces].all(axis=1))
