"""The large rigs run from mesh to scan at reduced resolution."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh

from synthgen.sampling.streams import stream
from synthgen.scanner import load_rig, scaled, scan, settings_for

pytestmark = pytest.mark.slow


def limb(start: Any, end: Any, radius: float) -> trimesh.Trimesh:
    a, b = np.array(start, float), np.array(end, float)
    capsule = trimesh.creation.capsule(np.linalg.norm(b - a), radius, count=[48, 48])
    return capsule.apply_transform(
        trimesh.geometry.align_vectors([0, 0, 1], (b - a) / np.linalg.norm(b - a))
    ).apply_translation((a + b) / 2)


def body() -> trimesh.Trimesh:
    """A mannequin of capsules standing on y = -1.05."""
    parts = [limb((0, -0.05, 0), (0, 0.4, 0), 0.16), limb((0, 0.62, 0), (0, 0.72, 0), 0.09)]
    for s in (-1, 1):
        parts.append(limb((s * 0.1, -0.97, 0), (s * 0.1, -0.1, 0), 0.075))
        parts.append(limb((s * 0.2, 0.45, 0), (s * 0.62, 0.3, 0), 0.05))
    return trimesh.util.concatenate(parts)


def foot() -> trimesh.Trimesh:
    """A foot and an ankle of capsules that stand on the glass at y = -0.1."""
    return trimesh.util.concatenate(
        [
            limb((0, -0.069, -0.07), (0, -0.069, 0.09), 0.03),
            limb((0, -0.06, -0.06), (0, 0.05, -0.06), 0.034),
        ]
    )


HEAD = trimesh.creation.icosphere(subdivisions=5, radius=0.09).apply_scale((0.85, 1.15, 1.0))


@pytest.mark.parametrize(
    ("name", "mesh", "factor", "voxel_m", "rms_m", "seen"),
    [
        ("body22", body(), 0.5, 0.004, 0.003, 15),
        ("head6", HEAD, 0.5, 0.002, 0.001, 5),
        ("foot10", foot(), 0.5, 0.002, 0.001, 8),
    ],
)
def test_smoke_mesh_to_scan(
    name: str, mesh: Any, factor: float, voxel_m: float, rms_m: float, seen: int
) -> None:
    rig = scaled(load_rig(name), factor)
    settings = settings_for(rig)
    fusion = replace(settings.fusion, voxel_m=voxel_m)
    settings = replace(settings, fusion=fusion, match=replace(settings.match, step=2))
    found = scan(mesh, rig, rng=stream(0, "sample", 0, 0, "scan"), settings=settings)
    assert found.problem is None
    assert sum(np.isfinite(unit.disparity).sum() > 200 for unit in found.units) >= seen
    error = found.provenance["error_m"]
    assert np.sqrt(np.mean(np.clip(error, -0.01, 0.01) ** 2)) < rms_m
    box = np.stack([found.vertices.min(axis=0), found.vertices.max(axis=0)])
    assert np.abs(box - mesh.bounds).max() < 0.05
