"""A small scene and its pictures, shared by the tests of the scanner's optics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh

from synthgen.geometry.transforms import look_at
from synthgen.scanner import ScanScene, Surface, load_rig, solid_from_mesh
from synthgen.scanner.rig import Glass, Rig

PLAIN = Surface(albedo=0.5, specular=0.0, subsurface=0.0)
SHINY = Surface(albedo=0.4, specular=1.0, roughness=0.4, subsurface=0.0)


def ball(
    radius: float = 0.012, centre: tuple[float, float, float] = (0, 0, 0.01)
) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    mesh.apply_translation(centre)
    return mesh


def wall(edge: float = 0.1, z: float = -0.01) -> trimesh.Trimesh:
    v = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * edge / 2 + [0, 0, z]
    return trimesh.Trimesh(v, [[0, 1, 2], [0, 2, 3]], process=False)


def ball_before_wall() -> ScanScene:
    return ScanScene((solid_from_mesh(ball(), SHINY), solid_from_mesh(wall(), PLAIN, smooth=False)))


def mini(seed: int = 0) -> Rig:
    return load_rig("mini", seed)


def quiet(rig: Rig) -> Rig:
    """The rig with sensors that add nothing but 12 bits, and a fixed gain."""
    still = replace(
        rig.grey, psf_px=0.0, shot_noise=False, read_noise_e=0.0, prnu=0.0, hot_share=0.0,
        bits=12, black_dn=0.0, gain=1.0,
    )  # fmt: skip
    return replace(rig, grey=still)


def from_below(rig: Rig) -> Rig:
    """The rig turned so that it looks up through a glass floor whose top is at y = -0.02."""
    units = tuple(
        replace(unit, nominal=_below(unit.nominal), true=_below(unit.true)) for unit in rig.units
    )
    projectors = tuple(replace(p, optics=_turned(p.optics)) for p in rig.projectors)
    return replace(rig, units=units, projectors=projectors, glass=Glass(-0.02, 0.015, 1.52))


def _below(calibration):  # type: ignore[no-untyped-def]
    return replace(
        calibration, left=_turned(calibration.left), right=_turned(calibration.right), colour=None
    )


def _turned(camera):  # type: ignore[no-untyped-def]
    x, y, z = camera.position
    T = look_at(np.array([x, -abs(z), y]), np.zeros(3), (0.0, 0.0, 1.0))
    return replace(camera, T_world_from_camera=tuple(tuple(float(v) for v in row) for row in T))
