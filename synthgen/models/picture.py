"""A picture of a model: its template, shape components and pose components.

Like figures 4 and 10 of Embodied Hands: on the left the mean, then a column for each component,
above what adding its standard deviations does, below what subtracting them does. Drawn with the
z-buffer of :mod:`synthgen.geometry.raster`, so that no renderer is needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError
from synthgen.geometry.cameras import camera_from_K
from synthgen.geometry.normals import unit, vertex_normals
from synthgen.geometry.raster import rasterise
from synthgen.models.hand_pca import finger_joints
from synthgen.models.model import BodyModel, Hand, HandSpace
from synthgen.models.packed import fold_joints
from synthgen.models.parts import part_vertices
from synthgen.models.views import View, view_of

Array = NDArray[np.float64]
Image = NDArray[np.float64]
SHAPE_SD, POSE_SD = 3.0, 2.0
# Pixels and inches of a tile: many small ones for hands, few large ones for bodies.
TILE = 220
TILE_BODY = 360
_PIXELS_PER_INCH = 152
_OVERSAMPLE = 3
_MARGIN = 1.12
_CLAY = np.array([0.80, 0.62, 0.50])
_LIGHTS = ((np.array([-0.75, 0.65, 0.45]), 0.95), (np.array([0.9, -0.2, 0.4]), 0.16))
_AMBIENT = 0.12
# So many meshes wide in front of the camera: nearly no perspective.
_DISTANCE = 12.0
_SUFFIXES = (".png", ".jpg", ".pdf")


@dataclass(frozen=True, eq=False)
class Row:
    """One family of components.

    Attributes
    ----------
    title, mean_title : str
    mean : (n, 3)
        Vertices.
    plus, minus : list of (n, 3)
        One per component.
    faces : (F, 3) int64
    view : View
    """

    title: str
    mean_title: str
    mean: Array
    plus: list[Array]
    minus: list[Array]
    faces: NDArray[np.int64]
    view: View


def model_picture(model: BodyModel, path: str | Path, *, components: int | None = None) -> Path:
    """Draw a model's components.

    Parameters
    ----------
    model : BodyModel
    path : str or Path
        ``.png``, ``.jpg`` or ``.pdf``.
    components : int or None
        Columns; None: ten for hands, five for bodies.

    Raises
    ------
    ModelError
        If the picture cannot be written there.
    """
    target = Path(path)
    if target.suffix not in _SUFFIXES:
        raise ModelError(f"{target}: pictures are written as {', '.join(_SUFFIXES)}")
    most = components or (10 if model.hand is not None else 5)
    rows = [_shape_row(model, most), *_expression_rows(model, most), *_pose_rows(model, most)]
    try:
        _figure(model, rows, target)
    except OSError as error:
        raise ModelError(f"{target}: cannot be written ({error.strerror})") from None
    return target


def _shape_row(model: BodyModel, most: int) -> Row:
    n = min(most, model.n_shape)
    every = np.arange(len(model.v_template))

    apart = _is_apart(model)

    def moved(k: int, sign: float) -> Array:
        offset = sign * SHAPE_SD * model.shapedirs[..., k]
        return np.asarray(model.v_template + offset - (offset.mean(axis=0) if apart else 0))

    title = f"shape: {n} of {model.n_shape} components, ± {SHAPE_SD:g} standard deviations"
    return _row(model, title, "template", n, model.v_template, moved, every, "")


def _is_apart(model: BodyModel) -> bool:
    """Tell whether the mesh is away from its root: the feet of a taller body are lower."""
    root, v = fold_joints(model)[0, 0], model.v_template
    return bool(((root < v.min(axis=0)) | (root > v.max(axis=0))).any())


def _expression_rows(model: BodyModel, most: int) -> list[Row]:
    directions = model.exprdirs
    if directions is None:
        return []
    n = min(most, model.n_expression)
    head = "head" in model.joint_names
    ids = part_vertices(model, "head") if head else np.arange(len(model.v_template))

    def moved(k: int, sign: float) -> Array:
        return np.asarray(model.v_template + sign * SHAPE_SD * directions[..., k])

    title = f"expression: {n} of {model.n_expression} components, ± {SHAPE_SD:g} sd"
    return [_row(model, title, "neutral", n, model.v_template, moved, ids, "head")]


def _pose_rows(model: BodyModel, most: int) -> list[Row]:
    """Return the components of a hand; of two one is enough, they are mirror images."""
    sides: tuple[Hand, ...] = ("right", "left") if model.hand is None else (model.hand,)
    for side in sides:
        space = model.hand_space(side)
        if space is not None:
            return [_pose_row(model, most, side, space)]
    return []


def _pose_row(model: BodyModel, most: int, side: Hand, space: HandSpace) -> Row:
    fingers, whole = finger_joints(model, side), model.hand is not None
    ids = np.arange(len(model.v_template)) if whole else part_vertices(model, f"{side}_hand")
    n, spread = min(most, len(space.components)), _spread(space)

    def posed(hand: Array) -> Array:
        pose = np.zeros((len(model.parents), 3))
        pose[fingers] = hand.reshape(-1, 3)
        vertices = model.evaluate(np.zeros((1, 1)), pose[None]).vertices[0]
        return np.asarray(vertices, dtype=np.float64)

    def moved(k: int, sign: float) -> Array:
        return posed(space.mean + sign * POSE_SD * spread[k] * space.components[k])

    unit_of = "standard deviations" if space.coeffs is not None else "(no table of poses)"
    name = "hand pose" if whole else f"pose of the {side} hand"
    title = f"{name}: {n} of {len(space.components)} components, ± {POSE_SD:g} {unit_of}"
    return _row(model, title, "mean pose", n, posed(space.mean), moved, ids, side)


def _spread(space: HandSpace) -> Array:
    """Return the deviation of each coefficient over the registered poses; 1 without them."""
    if space.coeffs is None or len(space.coeffs) < 2:
        return np.ones(len(space.components))
    return np.asarray(space.coeffs.std(axis=0))


def _row(
    model: BodyModel, title: str, mean_title: str, n: int, mean: Array,
    moved: Callable[[int, float], Array], ids: NDArray[np.int64], kind: str,
) -> Row:  # fmt: skip
    place = np.full(len(model.v_template), -1)
    place[ids] = np.arange(len(ids))
    faces = place[model.faces]
    return Row(
        title=title,
        mean_title=mean_title,
        mean=mean[ids],
        plus=[moved(k, 1.0)[ids] for k in range(n)],
        minus=[moved(k, -1.0)[ids] for k in range(n)],
        faces=faces[(faces >= 0).all(axis=1)],
        view=view_of(model, kind),
    )


def draw(
    vertices: Array,
    faces: NDArray[np.int64],
    view: View,
    centre: Array,
    reach: float,
    tile: int = TILE,
) -> Image:
    """Draw one mesh on white, (tile, tile, 3) sRGB in [0, 1].

    Parameters
    ----------
    vertices : (n, 3) metres
    faces : (F, 3)
    view : View
    centre : (3,) metres
        In the view's axes, x right, y up, z towards the viewer.
    reach : float
        Half of what the tile shows, metres.
    tile : int
        Pixels.
    """
    size = tile * _OVERSAMPLE
    local = vertices @ view.axes.T - centre
    seen = np.stack([local[:, 0], -local[:, 1], _DISTANCE * reach - local[:, 2]], axis=1)
    focal = 0.5 * size * _DISTANCE / _MARGIN
    middle = size / 2 - 0.5
    camera = camera_from_K(
        np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1]]), size, size
    )
    face_id, barycentric, _ = rasterise(seen, faces, camera)
    normals = vertex_normals(local, faces)
    image = np.ones((size, size, 3))
    hit = face_id >= 0
    corners = normals[faces[face_id[hit]]]
    normal = unit(np.einsum("pk,pkc->pc", barycentric[hit], corners))
    image[hit] = _shade(normal)
    blocks = image.reshape(tile, _OVERSAMPLE, tile, _OVERSAMPLE, 3).mean(axis=(1, 3))
    srgb: Image = np.clip(blocks, 0, 1) ** (1 / 2.2)
    return srgb


def _shade(normal: Array) -> Array:
    """Clay under two lamps; the inside of open meshes is darker."""
    inside = normal[:, 2] < 0
    facing = np.where(inside[:, None], -normal, normal)
    light = np.full(len(normal), _AMBIENT)
    for direction, strength in _LIGHTS:
        light += strength * np.clip(facing @ unit(direction), 0, None)
    light[inside] *= 0.45
    return np.asarray(light[:, None] * _CLAY)


def _frame(row: Row) -> tuple[Array, float]:
    """Return centre and half width that hold every mesh of a row."""
    every = np.concatenate([row.mean, *row.plus, *row.minus]) @ row.view.axes.T
    low, high = every.min(axis=0), every.max(axis=0)
    return (low + high) / 2, float((high - low)[:2].max() / 2)


def _figure(model: BodyModel, rows: list[Row], path: Path) -> None:
    from matplotlib.figure import Figure

    columns = 1 + max(len(row.plus) for row in rows)
    pixels = TILE if model.hand is not None else TILE_BODY
    side, line = pixels / _PIXELS_PER_INCH, 0.42  # inches
    height = len(rows) * (2 * side + line) + line
    figure = Figure(figsize=(columns * side, height), facecolor="white")
    title = f"{Path(model.name).stem}{' ' + model.hand if model.hand else ''}"
    counts = f"{len(model.v_template)} vertices, {len(model.parents)} joints"
    words = f"{title}   {model.family}, {counts}"
    figure.text(0.01, 1 - 0.26 / height, words, fontsize=12, va="center", weight="bold")

    def tile(image: Image, column: float, top: float, label: str = "") -> None:
        box = (column / columns, 1 - (top + side) / height, 1 / columns, side / height)
        axes = figure.add_axes(box)
        axes.imshow(image, interpolation="nearest")
        axes.set_axis_off()
        if label:
            axes.text(6, pixels - 8, label, fontsize=8, color="0.35")

    for k, row in enumerate(rows):
        top = line + k * (2 * side + line)
        figure.text(0.01, 1 - (top + 0.2) / height, row.title, fontsize=10, va="center")
        centre, reach = _frame(row)
        top += line
        mean = draw(row.mean, row.faces, row.view, centre, reach, pixels)
        tile(mean, 0, top + side / 2, row.mean_title)
        for j, (plus, minus) in enumerate(zip(row.plus, row.minus, strict=True)):
            above = draw(plus, row.faces, row.view, centre, reach, pixels)
            below = draw(minus, row.faces, row.view, centre, reach, pixels)
            tile(above, j + 1, top, f"+ {j + 1}")
            tile(below, j + 1, top + side, f"− {j + 1}")
    figure.savefig(path, dpi=_PIXELS_PER_INCH)
