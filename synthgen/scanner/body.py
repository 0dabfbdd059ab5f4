"""Bodies of SMPL+H, SUPR and STAR models as something to scan: skin, eyes and clothes, or a part.

A part is what lies on the kept side of some planes, closed where they cut; see
:mod:`synthgen.scanner.cap`.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError, ShapeError, nearest
from synthgen.geometry.normals import vertex_normals
from synthgen.geometry.subdivision import InterpolatingSubdivision
from synthgen.models import BodyModel, attachments_of, deform_feet, dressed, feet_of
from synthgen.render.sensor import LUMINANCE
from synthgen.scanner.cap import cut_and_cap
from synthgen.scanner.rig import Rig
from synthgen.scanner.segment import CropPlane
from synthgen.scanner.subject import SKIN, ScanScene, Solid, Surface, placed

Array = NDArray[np.float64]
# How far a foot that stands would go through the ground if it did not give way.
PRESSED_M = 0.003


def body_scene(
    model: BodyModel,
    shape: NDArray[Any] | None = None,
    pose: NDArray[Any] | None = None,
    *,
    wear: Iterable[str] = ("eyes", "garment"),
    keep: Iterable[CropPlane] = (),
    pressed: bool = False,
    skin: Surface = SKIN,
    levels: int = 2,
) -> ScanScene:
    """Pose a body and make solids of it.

    Parameters
    ----------
    model : BodyModel
        Of any family.
    shape : (nb,) float, optional
        Betas; default 0.
    pose : (K, 3) float, optional
        Axis-angle; default the model's rest pose.
    wear : iterable of str
        Attachments of a shipped model (``eyes``, ``garment``, ...) that come with it; those that a
        model of yours lacks are left out.
    keep : iterable of CropPlane
        Cuts, one after the other, in the model's frame: of each the largest piece on the kept side
        stays, closed where it was cut.
    pressed : bool
        The feet stand on the ground and give way (shipped SUPR form only).
    skin : Surface
    levels : int
        How often the skin's triangles are split in four, smoothly, through the model's vertices.

    Returns
    -------
    ScanScene
        In the model's frame, metres; see :func:`standing` and :func:`centred`.

    Raises
    ------
    ModelError
        If ``wear`` names what the shipped model does not have, or the feet cannot give way.
    ShapeError
        If nothing lies on the kept sides.
    """
    betas = np.zeros((1, model.n_shape)) if shape is None else np.asarray(shape)[None]
    turns = np.zeros((1, len(model.parents), 3)) if pose is None else np.asarray(pose)[None]
    vertices, planes = _posed(model, betas, turns, pressed), tuple(keep)
    fine = InterpolatingSubdivision.build(model.faces, len(model.v_template), levels)
    solids = [_solid(fine.apply(vertices), fine.faces, planes, skin)]
    chosen = [a for a in attachments_of(model) if a.name in _known(model, wear)]
    for attachment, points in zip(
        chosen, dressed(model, chosen, betas, turns).values(), strict=True
    ):
        colours = _per_vertex(attachment.colour, attachment.faces, len(points[0]))
        solids.append(_solid(points[0], attachment.faces, planes, None, colours))
    kept = tuple(solid for solid in solids if solid is not None)
    if not kept:
        raise ShapeError(f"nothing of {model.name} lies on the kept side of {planes}")
    return ScanScene(kept)


def _posed(model: BodyModel, betas: Array, turns: Array, pressed: bool) -> NDArray[np.float32]:
    """Return the skin's vertices (V, 3)."""
    posed = model.evaluate(betas, turns)
    if not pressed:
        return np.asarray(posed.vertices[0])
    ground = float(posed.vertices[..., 1].min()) + PRESSED_M
    plane = (0.0, 1.0, 0.0, ground)
    feet = feet_of(model)
    frames, weights = posed.transforms, model.weights
    whole = deform_feet(feet, posed.vertices, frames, weights, betas, turns, plane)
    return np.asarray(whole[0])


def standing(scene: ScanScene, rig: Rig) -> ScanScene:
    """Put a scene upright on the rig's floor: its glass, or the bottom of its working volume."""
    low, high = _box(scene)
    floor = -rig.volume_m[1] / 2 if rig.glass is None else rig.glass.top_m
    return _shifted(scene, [-(low[0] + high[0]) / 2, floor - low[1], -(low[2] + high[2]) / 2])


def centred(scene: ScanScene) -> ScanScene:
    """Put the middle of a scene's box in the middle of the working volume."""
    low, high = _box(scene)
    return _shifted(scene, -(low + high) / 2)


def _box(scene: ScanScene) -> tuple[Array, Array]:
    points = np.concatenate([solid.vertices for solid in scene.solids])
    return points.min(axis=0), points.max(axis=0)


def _shifted(scene: ScanScene, shift: Any) -> ScanScene:
    T = np.eye(4)
    T[:3, 3] = shift
    return placed(scene, T)


def _known(model: BodyModel, wear: Iterable[str]) -> set[str]:
    asked, there = set(wear), [a.name for a in attachments_of(model)]
    for name in sorted(asked - set(there)) if there else ():
        raise ModelError(
            f"{model.name} has no {name!r}{nearest(name, there)}; it wears {', '.join(there)}"
        )
    return asked


def _solid(
    points: NDArray[Any], faces: NDArray[Any], planes: tuple[CropPlane, ...],
    surface: Surface | None, colours: Array | None = None,
) -> Solid | None:  # fmt: skip
    """Cut and close one mesh; None where nothing of it is kept. Cloth is matt."""
    stacked = np.asarray(points, np.float64)
    if colours is not None:
        stacked = np.concatenate([stacked, colours], axis=1)
    triangles = np.asarray(faces, np.int64)
    for plane in planes:
        kept = plane.keeps(stacked[:, :3])
        if kept.all():  # eyes are two pieces, of which a cut would keep one
            continue
        if not kept[triangles].all(axis=1).any():
            return None
        cut = cut_and_cap(stacked, triangles, plane)
        stacked, triangles = cut.vertices, cut.faces
    place = np.ascontiguousarray(stacked[:, :3])
    rest = None if colours is None else stacked[:, 3:]
    if surface is None and rest is not None:
        surface = Surface(float(np.median(rest @ LUMINANCE)), specular=0.2, subsurface=0.0)
    return Solid(
        place, triangles, vertex_normals(place, triangles), surface or SKIN, "subject", None, rest
    )


def _per_vertex(colour: NDArray[np.uint8], faces: NDArray[np.int64], n: int) -> Array:
    """Linear reflectance (n, 3) of vertices from the sRGB colours (F, 3) of their faces."""
    linear = (np.asarray(colour, np.float64) / 255) ** 2.2
    total, count = np.zeros((n, 3)), np.zeros(n)
    for corner in faces.T:
        np.add.at(total, corner, linear)
        np.add.at(count, corner, 1)
    return np.asarray(total / np.maximum(count, 1)[:, None])
