"""Is the subject where the scanner looks, and is every device outside of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ScanError
from synthgen.scanner.rig import Rig
from synthgen.scanner.subject import ScanScene, Solid

Array = NDArray[np.float64]


def check_placement(scene: ScanScene, rig: Rig) -> None:
    """Refuse a scene that the rig cannot scan.

    Raises
    ------
    ScanError
        If there is no solid, no triangle reaches into the working volume, or a camera or projector
        stands inside a solid or inside the glass; the message names it.
    """
    if not scene.solids:
        raise ScanError(f"rig {rig.name}: the scene holds no solid; give at least one mesh")
    for name, position in _devices(rig):
        for k, solid in enumerate(scene.solids):
            if _may_hold(solid, position) and _holds(solid, position):
                raise ScanError(
                    f"rig {rig.name}: {name} at {_point(position)} m is inside solid {k}; move the "
                    "subject to the centre of the working volume, or check that it is in metres"
                )
        glass = rig.glass
        if glass and 0 <= glass.top_m - position[1] <= glass.thickness_m:
            raise ScanError(f"rig {rig.name}: {name} at {_point(position)} m is inside the glass")
    half = np.array(rig.volume_m) / 2
    if not any(_reaches(solid, half) for solid in scene.solids):
        points = np.concatenate([solid.vertices for solid in scene.solids])
        low, high = points.min(axis=0), points.max(axis=0)
        raise ScanError(
            f"rig {rig.name}: the working volume is {_box(-half, half)} m about the origin, the "
            f"subject lies in {_box(low, high)} m: nothing to scan. Meshes are in metres, in the "
            "rig's frame (y up); see `synthgen doctor rig`"
        )


def _reaches(solid: Solid, half: Array) -> bool:
    """Tell whether the bounding box of some triangle meets the box from ``-half`` to ``half``."""
    corners = solid.vertices[solid.faces]
    meets = (corners.min(axis=1) <= half) & (corners.max(axis=1) >= -half)
    return bool(meets.all(axis=1).any())


def _devices(rig: Rig) -> list[tuple[str, Array]]:
    found = []
    for unit in rig.units:
        for role in ("left", "right", "colour"):
            camera = getattr(unit.true, role)
            if camera is not None:
                found.append((f"unit {unit.ident}: the {role} camera", camera.position))
    return found + [(f"projector {p.ident}", p.optics.position) for p in rig.projectors]


def _may_hold(solid: Solid, point: Array) -> bool:
    low, high = solid.vertices.min(axis=0), solid.vertices.max(axis=0)
    return bool((point >= low).all() and (point <= high).all())


def _holds(solid: Solid, point: Array) -> bool:
    # Walls of a room may face the devices inside it; a subject's faces that do are turned round.
    turns = winding_number(solid, point)
    return (abs(turns) if solid.kind == "subject" else turns) > 0.5


def winding_number(solid: Solid, point: Array) -> float:
    """Return the winding number of a solid about a point: 1 inside, 0 outside, between at holes.

    -1 is inside of faces that run the wrong way.

    The sum of the triangles' solid angles over 4 pi (van Oosterom and Strackee 1983).
    """
    a, b, c = (solid.vertices[solid.faces[:, k]] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    volume = np.einsum("fk,fk->f", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("fk,fk->f", u, v) for u, v in ((a, b), (b, c), (c, a)))
    angle = 2 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
    return float(angle.sum() / (4 * np.pi))


def _box(low: Array, high: Array) -> str:
    return " x ".join(f"[{a:.3g}, {b:.3g}]" for a, b in zip(low, high, strict=True))


def _point(p: Array) -> str:
    return "(" + ", ".join(f"{v:.3g}" for v in p) + ")"
