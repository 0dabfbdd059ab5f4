"""Solids whose surface is known in closed form: plates, balls, cylinders; matt."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

from benchmarks.scanner_parts.setting import axes
from synthgen.scanner import Solid, Surface, solid_from_mesh
from synthgen.scanner.rig import Rig

PLAIN = Surface(specular=0.0, subsurface=0.0)


def plate(of: Rig, size: Any, centre: Any, tilt_deg: float = 0.0) -> Solid:
    """Return a box whose largest face looks at the first pair, turned about its upright."""
    box = trimesh.creation.box(size)
    T = np.eye(4)
    turn = trimesh.transformations.rotation_matrix(np.deg2rad(tilt_deg), (0, 1, 0))
    T[:3, :3] = axes(of) @ turn[:3, :3]
    T[:3, 3] = axes(of) @ np.array(centre)
    return solid_from_mesh(box.apply_transform(T), PLAIN, smooth=False)


def ball(radius_m: float, centre: Any = (0, 0, 0), surface: Surface = PLAIN, **rest: Any) -> Solid:
    """Return a sphere of 80,000 triangles, within 0.5 um for the radius of a finger."""
    mesh = trimesh.creation.icosphere(subdivisions=6, radius=radius_m)
    return solid_from_mesh(mesh.apply_translation(centre), surface, **rest)


def cylinders(gap_m: float, radius_m: float = 0.008, length_m: float = 0.06) -> list[Solid]:
    """Return two upright cylinders side by side, as two fingers."""
    found = []
    for side in (-1, 1):
        T = trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0))
        T[0, 3] = side * (radius_m + gap_m / 2)
        tube = trimesh.creation.cylinder(radius_m, length_m, sections=384)
        found.append(solid_from_mesh(tube.apply_transform(T), PLAIN, smooth=False))
    return found
