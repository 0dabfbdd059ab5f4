"""The other rigs from mesh to scan: a body, a head, a foot on glass, a consumer depth camera.

At half resolution (the depth camera at its own), with default calibration errors. Pictures and
textured GLB files go to ``out/rigs_bench``. Takes two to three CPU minutes.
"""

from __future__ import annotations

import resource
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

PICTURES = Path("out/rigs_bench")
# Rig, level, voxel in metres; finer ones resolve the gaps between toes.
RUNS = (("body22", "half", 0.003), ("head6", "half", 0.002), ("foot10", "half", 0.0015),
        ("consumer", "full", 0.003))  # fmt: skip
_MB = 1024  # of what the system counts memory in, KB


def run(rows: tuple[str, ...] = (), pictures: Path = PICTURES) -> dict[str, Any]:
    """Scan what each rig is for; one row per rig, or only those named."""
    chosen = [case for case in RUNS if not rows or case[0] in rows]
    return {
        "title": "rigs from mesh to scan at reduced resolution; seen and never-seen surface within "
        "two voxels of the scan",
        "columns": ["rig", "pixels", "voxel mm", "units", "vertices", "RMS mm", "p99 mm",
                    "seen covered", "unseen covered", "CPU s", "peak MB"],
        "rows": [row(*case, pictures) for case in chosen],
        "notes": ["peak: of the process until the scan was there; run a rig alone for its own",
                  f"pictures: {pictures}"],
    }  # fmt: skip


def subject(name: str, rig: Any) -> Any:
    """Return what stands before a rig."""
    from synthgen.models import load
    from synthgen.scanner import CropPlane, body_scene, centred, standing

    body = load("cc0-body" if name == "body22" else "cc0-supr")
    joint = dict(zip(body.joint_names, body.evaluate(
        np.zeros((1, body.n_shape)), np.zeros((1, len(body.parents), 3))
    ).joints[0].tolist(), strict=True))  # fmt: skip
    if name == "body22":
        pose = np.zeros((len(body.parents), 3))
        pose[body.joint_names.index("left_shoulder"), 2] = -0.8
        pose[body.joint_names.index("right_shoulder"), 2] = 0.8
        return standing(body_scene(body, pose=pose), rig)
    if name == "foot10":
        x, y, z = joint["left_ankle"]
        leg = CropPlane((0, 0, 0), (1, 0, 0)), CropPlane((x, y + 0.05, z), (0, -1, 0))
        return standing(body_scene(body, wear=(), keep=leg, pressed=True), rig)
    x, y, z = joint["neck"]
    neck = CropPlane((x, y - 0.03, z), (0, 1, 0))
    return centred(body_scene(body, wear=("eyes",), keep=(neck,)))


def row(name: str, level: Any, voxel_m: float, pictures: Path) -> list[Any]:
    """Scan with one rig: figures; pictures and a GLB file go to a folder."""
    import cv2

    from synthgen.corpus.scan_pictures import scan_pictures
    from synthgen.sampling import stream
    from synthgen.scanner import load_rig, save_scan, scaled, scan, settings_for

    rig = load_rig(name)
    settings = settings_for(rig, level)
    settings = replace(settings, fusion=replace(settings.fusion, voxel_m=voxel_m))
    scene = subject(name, rig)
    begun, rng = time.process_time(), stream(0, "sample", 0, 0, "b")
    found = scan(scene, rig, rng=rng, level=level, settings=settings)
    spent = time.process_time() - begun
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _MB
    pictures.mkdir(parents=True, exist_ok=True)
    for what, picture in scan_pictures(found).items():
        cv2.imwrite(str(pictures / f"{name}_{what}.png"), picture[..., ::-1])
    save_scan(found, pictures / f"{name}.glb")
    error = 1e3 * found.provenance["error_m"].astype(np.float64)
    used = scaled(rig, 0.5) if level == "half" else rig
    left = used.units[0].nominal.left
    working = sum(u["matched"] > 200 for u in found.report["units"].values())
    covered, invented = _covered(scene, used, found, 2 * voxel_m)
    return [name, f"{left.width}x{left.height}", 1e3 * voxel_m, f"{working}/{len(rig.units)}",
            len(found.vertices), float(np.sqrt(np.mean(error**2))),
            float(np.quantile(np.abs(error), 0.99)), covered, invented, spent, peak]  # fmt: skip


def _covered(scene: Any, rig: Any, found: Any, within_m: float) -> tuple[float, float]:
    """Shares of the surface that two cameras of some unit see, and of the rest, near the scan."""
    from synthgen.sampling import stream
    from synthgen.scanner.evaluate import coverage, seen_by_pairs, surface_samples
    from synthgen.scanner.stage import prepare

    stage = prepare(scene, rig, rng=stream(0, "sample", 0, 0, "b"))
    parts = [surface_samples(s.vertices, s.faces) for s in scene.solids]
    points, normals, areas = (np.concatenate(own) for own in zip(*parts, strict=True))
    seen = seen_by_pairs(stage, rig.units, points, normals)
    return coverage(found, points, areas, seen, within_m)
