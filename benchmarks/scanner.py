"""Self-test of the scanner, T1-T9: planes, noise, spheres, edges, webbing, hand, motion, green.

Pictures go to ``out/scanner_bench``. Takes four to five CPU minutes.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

PICTURES = Path("out/scanner_bench")
MATTE = {"specular": False, "subsurface": False, "defocus": False, "bounce": False}
PATTERNS, SEEDS, NOISE_DRAWS = 16, 20, 8
Row = list[Any]


def run() -> dict[str, Any]:
    """Run every test; each row is what, measured, the target and whether it is met."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    for test in (planes, noise, spheres, spacing, step_edge, webbing, motion, hand, budget, green):
        begun = time.process_time()
        rows += test()
        rows.append([f"({test.__name__}: CPU s)", time.process_time() - begun, "", ""])
    return {
        "title": "hand5 scanner; millimetres unless said; 'none' where no target is set",
        "columns": ["what", "measured", "target", "met"],
        "rows": rows,
        "notes": [f"pictures: {PICTURES}"],
    }


def _row(what: str, value: float, low: float | None = None, high: float | None = None) -> Row:
    if low is None and high is None:
        return [what, value, "none", ""]
    met = (low is None or value >= low) and (high is None or value <= high)
    shown = f"{low}..{high}" if low is not None and high is not None else (
        f"<= {high}" if low is None else f">= {low}")  # fmt: skip
    return [what, value, shown, "yes" if met else "NO"]


def _rig(seed: int = 0, units: Any = None, exact: bool = True) -> Any:
    """hand5; ``exact`` has true calibration equal to nominal and synchronous units."""
    from synthgen.scanner import load_rig
    from synthgen.scanner.rig import only

    rig = load_rig("hand5", seed)
    if exact:
        known = tuple(replace(u, true=u.nominal) for u in rig.units)
        rig = replace(rig, units=known, sync_s=0.0)
    return rig if units is None else only(rig, units)


def _settings(rig: Any, **changes: Any) -> Any:
    from synthgen.scanner import settings_for

    fine = replace(settings_for(rig), colour=False, true_disparity=True, spp=9)
    return replace(fine, **changes)


def _front(solids: Any, rig: Any, key: int = 0, **changes: Any) -> Any:
    """Let the front unit alone measure solids without skin effects: stage, measurement."""
    from synthgen.sampling import stream
    from synthgen.scanner import Effects, ScanScene
    from synthgen.scanner.pipeline import measure
    from synthgen.scanner.stage import prepare

    scene = ScanScene(tuple(solids))
    stage = prepare(scene, rig, rng=stream(key, "sample", 0, 0, "b"), effects=Effects(**MATTE))
    return stage, measure(stage, rig.units[0], "full", _settings(rig, **changes))


def _axes(rig: Any) -> Any:
    """Right, up and towards the first pair: columns (3, 3)."""
    from synthgen.geometry.normals import unit

    left, right = (c.position for c in (rig.units[0].nominal.left, rig.units[0].nominal.right))
    ahead, aside = unit((left + right) / 2), unit(right - left)
    return np.stack([aside, np.cross(ahead, aside), ahead], axis=1)


def _matt() -> Any:
    from synthgen.scanner import Surface

    return Surface(specular=0.0, subsurface=0.0)


def _plate(rig: Any, size: Any, centre: Any, tilt_deg: float = 0.0) -> Any:
    import trimesh

    from synthgen.scanner import solid_from_mesh

    box = trimesh.creation.box(size)
    T = np.eye(4)
    turn = trimesh.transformations.rotation_matrix(np.deg2rad(tilt_deg), (0, 1, 0))
    T[:3, :3] = _axes(rig) @ turn[:3, :3]
    T[:3, 3] = _axes(rig) @ np.array(centre)
    return solid_from_mesh(box.apply_transform(T), _matt(), smooth=False)


def _ball(radius_m: float, centre: Any = (0, 0, 0), surface: Any = None, **rest: Any) -> Any:
    import trimesh

    from synthgen.scanner import solid_from_mesh

    ball = trimesh.creation.icosphere(subdivisions=6, radius=radius_m)
    return solid_from_mesh(ball.apply_translation(centre), surface or _matt(), **rest)


def planes() -> list[Row]:
    """T1: a plate at 0, 30 and 55 degrees."""
    from synthgen.scanner.evaluate import pair_figures

    rig, rows = _rig(units=["front"]), []
    for tilt in (0, 30, 55):
        _, part = _front([_plate(rig, (0.06, 0.06, 0.004), (0, 0, 0), tilt)], rig)
        f = pair_figures(part.unit)
        rows += [_row(f"T1 plane {tilt} deg: core RMS", f.core_mm),
                 _row(f"T1 plane {tilt} deg: bias", f.bias_mm),
                 _row(f"T1 plane {tilt} deg: fill", f.complete)]  # fmt: skip
    return rows


def noise() -> list[Row]:
    """T2: temporal noise of a plane against the Cramer-Rao bound."""
    import cv2

    from synthgen.scanner.evaluate import predicted_sigma
    from synthgen.scanner.exposure import digitised, speckle_radiance
    from synthgen.scanner.match import FAST, match
    from synthgen.scanner.pipeline import disparity_bounds
    from synthgen.scanner.rectify import rectify, rectify_images
    from synthgen.scanner.sensor import automatic_gain, optical

    rig = _rig(units=["front"])
    unit = rig.units[0]
    stage, _ = _front([_plate(rig, (0.04, 0.04, 0.004), (0, 0, 0))], rig)
    sensor = rig.grey
    light = [optical(speckle_radiance(stage, unit, r, spp=9), sensor, unit.true.camera(r))
             for r in ("left", "right")]  # fmt: skip
    gain = automatic_gain(light, rig.light.background, sensor.auto_target) or 1.0
    pair = rectify(unit.nominal.left, unit.nominal.right)
    pictures, grids = [], []
    for draw in range(NOISE_DRAWS):
        stage.key = draw
        raw = [digitised(stage, unit, role, picture, sensor, gain)  # type: ignore[arg-type]
               for role, picture in zip(("left", "right"), light, strict=True)]  # fmt: skip
        left, right = rectify_images(pair, (raw[0], raw[1]))
        pictures.append(left)
        grids.append(match(left, right, disparity_bounds(rig, pair), FAST).disparity)
    mean = np.mean(pictures, axis=0)
    per_dn = sensor.full_well_e / 255
    sigma = np.sqrt((np.maximum(mean - sensor.black_dn, 0) * per_dn + sensor.read_noise_e**2)
                    / per_dn**2 + 1 / 12)  # fmt: skip
    expected = predicted_sigma(mean, sigma, FAST.dic)[:: FAST.step, :: FAST.step]
    spread = np.std(grids, axis=0, ddof=1)
    whole = np.isfinite(spread).astype(np.uint8)
    known = cv2.erode(whole, np.ones((7, 7), np.uint8)) > 0
    ratio = float(np.sqrt(np.mean(spread[known] ** 2) / np.mean(expected[known] ** 2)))
    return [_row("T2 temporal noise, px", float(np.sqrt(np.mean(spread[known] ** 2)))),
            _row("T2 temporal noise / Cramer-Rao bound", ratio, 0.9, 1.3)]  # fmt: skip


def spheres() -> list[Row]:
    """T3: radial error of a finger-sized and a larger sphere where they face the pair."""
    from synthgen.geometry.normals import unit
    from synthgen.scanner.range_grid import triangulate

    rows = []
    for radius, patterns in ((0.009, PATTERNS), (0.025, 4)):
        means, squares = [], []
        for seed in range(patterns):
            rig = _rig(seed, ["front"])
            _, part = _front([_ball(radius)], rig, seed)
            d = part.unit.disparity.astype(np.float64)
            y, x = np.indices(d.shape) * part.unit.step
            points = triangulate(part.unit.pair, x, y, d)[np.isfinite(d)]
            sight = unit(part.unit.pair.left.position - points)
            facing = np.einsum("nk,nk->n", unit(points), sight) > 0.7
            error = 1e3 * (np.linalg.norm(points, axis=1) - radius)[facing]
            means.append(error.mean())
            squares.append(np.mean(error**2))
        name = f"T3 sphere r {1e3 * radius:.0f}, {patterns} patterns"
        bound = 0.005 if radius < 0.01 else None
        rows += [_row(f"{name}: |convexity bias|", abs(float(np.mean(means))), None, bound),
                 _row(f"{name}: sd of the bias", float(np.std(means))),
                 _row(f"{name}: form RMS", float(np.sqrt(np.mean(squares))))]  # fmt: skip
    return rows


def spacing() -> list[Row]:
    """T4: distance of two spheres over all units, half resolution, exact and default."""
    from scipy.optimize import least_squares

    from synthgen.sampling import stream
    from synthgen.scanner import ScanScene, scan, settings_for

    r, centres, rows = 0.012, np.array([[-0.03, 0, 0], [0.03, 0, 0]]), []
    for exact in (True, False):
        rig = _rig(exact=exact)
        settings = replace(settings_for(rig, "half"), colour=False)
        solids = tuple(_ball(r, c) for c in centres)
        found = scan(ScanScene(solids), rig, rng=stream(0, "sample", 0, 0, "b"), level="half",
                     settings=settings)  # fmt: skip
        fitted = []
        for k, centre in enumerate(centres):
            own = found.vertices[found.provenance["solid"] == k].astype(np.float64)
            fit = least_squares(
                lambda c, own=own: np.linalg.norm(own - c, axis=1) - r, centre, loss="soft_l1",
                f_scale=1e-4,
            )  # fmt: skip
            fitted.append(fit.x)
        error = 1e3 * float(np.linalg.norm(fitted[1] - fitted[0]) - 0.06)
        rows.append(_row(f"T4 spacing error, {'exact' if exact else 'default'} calibration", error))
    return rows


def step_edge() -> list[Row]:
    """T5: how far a near plate's depth reaches over its edge."""
    rig = _rig(units=["front"])
    near = _plate(rig, (0.03, 0.04, 0.002), (-0.02, 0, 0.01))
    far = _plate(rig, (0.09, 0.05, 0.002), (0, 0, -0.005))
    _, part = _front([near, far], rig)
    d, true = part.unit.disparity, part.unit.true_disparity
    pair = part.unit.pair
    middle = float(pair.disparity(pair.depth(np.nanmedian(true)) - 0.004))
    wrong = np.isfinite(d) & np.isfinite(true) & (d > middle) & (true < middle)
    rows_hit = (np.isfinite(true) & (true > middle)).any(axis=1).sum()
    width = wrong.sum() / max(rows_hit, 1) * part.unit.step * 0.185
    return [_row("T5 edge fattening, both sides, per row", float(width))]


def webbing() -> list[Row]:
    """T6: two cylinders of 8 mm radius side by side: surface that bridges the gap."""
    import trimesh

    from synthgen.scanner import ScanScene, solid_from_mesh
    from synthgen.scanner.pipeline import assemble

    rig, rows = _rig(units=["front"]), []
    for gap in (0.0, 0.001, 0.003, 0.01):
        solids = []
        for side in (-1, 1):
            T = np.eye(4)
            T[:3, :3] = trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0))[:3, :3]
            T[0, 3] = side * (0.008 + gap / 2)
            tube = trimesh.creation.cylinder(0.008, 0.06, sections=96).apply_transform(T)
            solids.append(solid_from_mesh(tube, _matt(), smooth=False))
        _, part = _front(solids, rig)
        found = assemble([part], ScanScene(tuple(solids)), "full", _settings(rig))
        outside = found.provenance["error_m"] > 0.0005
        rows.append(_row(f"T6 gap {1e3 * gap:.0f}: share outside > 0.5", float(outside.mean())))
    return rows


def motion() -> list[Row]:
    """T8: a sphere that moves across: where it is put, with a global and a rolling shutter."""
    rows = []
    for speed, delay in ((0.0, 0.0), (0.3, 0.0), (1.0, 0.0), (0.3, 1e-5)):
        rig = _rig(units=["front"])
        rig = replace(rig, grey=replace(rig.grey, line_delay_s=delay))
        ball = _ball(0.015, velocity_m_s=np.array([speed, 0.0, 0.0]))
        _, part = _front([ball], rig)
        points = part.grid.world_points()
        error = 1e3 * (np.linalg.norm(points, axis=1) - 0.015)
        name = f"T8 sphere at {speed} m/s{', rolling 10 us per row' if delay else ''}"
        rows.append(_row(f"{name}: RMS", float(np.sqrt(np.mean(error**2)))))
    return rows


def _hand(index: int = 0, spin: float = 0.0, settings: Any = ()) -> Any:
    from synthgen.config import load_config
    from synthgen.sampling.draw import draw_sample
    from synthgen.scanner.hand import hand_solid, put_in_rig

    asked = ["pose.gmm_share=1", "model.hands=right", *settings]
    subject = draw_sample(load_config("hand_rgbd", asked), index).scene.subjects[0]
    flat = tuple([subject.pose[0], *[(0.0, 0.0, 0.0)] * 15])
    return hand_solid(put_in_rig(replace(subject, pose=flat), spin))


def hand() -> list[Row]:
    """T7: a flat hand without added errors: pairs, fusion, holes, time."""
    from synthgen.sampling import stream
    from synthgen.scanner import Effects, ScanScene
    from synthgen.scanner.evaluate import coverage, pair_figures, seen_by_pairs, surface_samples
    from synthgen.scanner.match import BEST
    from synthgen.scanner.pipeline import assemble, measure
    from synthgen.scanner.stage import prepare

    rig, held = _rig(), _hand()
    solid = held.solid
    scene, effects = ScanScene((solid,)), Effects(**MATTE)
    stage = prepare(scene, rig, rng=stream(0, "sample", 0, 0, "b"), effects=effects)
    parts = [measure(stage, unit, "full", _settings(rig)) for unit in rig.units]
    facing = max(parts, key=lambda p: int(np.isfinite(p.unit.disparity).sum()))
    f = pair_figures(facing.unit)
    best = measure(stage, rig.unit(facing.unit.ident), "full", _settings(rig, match=BEST))
    b = pair_figures(best.unit)
    found = assemble(parts, scene, "full", _settings(rig))
    skin = solid.faces[held.source >= 0]
    points, normals, areas = surface_samples(solid.vertices, skin)
    known = seen_by_pairs(stage, rig.units, points, normals)
    seen, invented = coverage(found, points, areas, known, 1e-3)
    error = 1e3 * found.provenance["error_m"]
    _pictures(found, "hand_exact")
    return [
        _row("T7 facing pair: core RMS", f.core_mm, None, 0.05),
        _row("T7 facing pair: RMS with edges", f.all_mm, None, 0.10),
        _row("T7 facing pair: outliers > 1 mm", f.outliers, None, 0.004),
        _row("T7 facing pair: completeness", f.complete, 0.97),
        _row("T7 best preset: core RMS", b.core_mm, None, 0.04),
        _row("T7 best preset: RMS with edges", b.all_mm, None, 0.075),
        *[_row(f"T7 unit {p.unit.ident}: core RMS", pair_figures(p.unit).core_mm) for p in parts],
        _row("T7 fused, exact: RMS", float(np.sqrt(np.mean(error**2))), None, 0.04),
        _row("T7 fused: seen surface within 1 mm", seen, 0.90),
        _row("T7 fused: never-seen surface invented", invented, None, 0.05),
        _row("T7 fused: vertices, thousands", len(found.vertices) / 1e3, 50, 90),
    ]


def budget() -> list[Row]:
    """Split the default error budget term by term, its spread over scanner seeds, and the cost."""
    from synthgen.sampling import stream
    from synthgen.scanner import Effects, ScanScene, scan, settings_for
    from synthgen.scanner.pipeline import assemble, measure
    from synthgen.scanner.stage import prepare

    solid, rows = _hand(1).solid, []
    scene = ScanScene((solid,))
    terms = {"nothing": MATTE, "defocus": MATTE | {"defocus": True},
             "skin and gloss": MATTE | {"specular": True, "subsurface": True},
             "all light": {}}  # fmt: skip
    for name, effects in terms.items():
        rig = _rig()
        found = scan(scene, rig, rng=stream(0, "sample", 0, 0, "b"),
                     settings=replace(settings_for(rig), colour=False),
                     effects=Effects(**effects))  # fmt: skip
        rows.append(_row(f"budget, exact calibration, {name}: fused RMS", _fused_rms(found)))
    rig = _rig(exact=False)
    for level, colour, most in (("full", False, 28), ("full", True, 58), ("half", False, 9)):
        begun = time.process_time()
        settings = replace(settings_for(rig, level), colour=colour, truth=False)  # type: ignore[arg-type]
        found = scan(scene, rig, rng=stream(0, "sample", 0, 0, "b"), level=level, settings=settings)  # type: ignore[arg-type]
        rows.append(_row(f"{level}{', colour' if colour else ''}: CPU s",
                         time.process_time() - begun, None, most))  # fmt: skip
    _pictures(found, "hand_half")
    stage, values = prepare(scene, rig, rng=stream(0, "sample", 0, 0, "b")), []
    for seed in range(SEEDS):
        other, stage.key = _rig(seed, exact=False), seed
        parts = [
            measure(
                stage,
                unit,
                "model",
                _settings(
                    rig,
                ),
            )
            for unit in other.units
        ]
        values.append(_fused_rms(assemble(parts, scene, "model", _settings(rig))))
    low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
    return [*rows,
            _row(f"default budget, level model, {SEEDS} scanners: median RMS", middle, 0.17, 0.23),
            _row("default budget: 10 % quantile", low),
            _row("default budget: 90 % quantile", high)]  # fmt: skip


def _fused_rms(found: Any) -> float:
    error = 1e3 * found.provenance["error_m"]
    return float(np.sqrt(np.mean(np.clip(error, -2, 2) ** 2)))


def green() -> list[Row]:
    """T9: the green-object rule over skin tones and lights."""
    from synthgen.sampling import stream
    from synthgen.scanner import ScanScene, is_green, scan, settings_for
    from synthgen.scanner.subject import GREEN

    rows = []
    for tone, dim in ((0.05, False), (0.95, False), (0.5, True)):
        rig = _rig(exact=False)
        if dim:
            rig = replace(rig, light=replace(rig.light, white=rig.light.white[:2]))
        hand_ = _hand(2, settings=[f"skin.tones=[{tone},{tone}]"]).solid
        front = hand_.vertices[np.argmax(hand_.vertices[:, 2])]
        ball = _ball(0.022, front + [0, 0, 0.0215], GREEN)
        settings = settings_for(rig, "half")
        found = scan(ScanScene((hand_, ball)), rig, rng=stream(0, "sample", 0, 0, "b"),
                     level="half", settings=settings)  # fmt: skip
        green_ = is_green(found.colors)
        seen = found.provenance["colour_unit"] >= 0
        on = found.provenance["solid"] == 1
        name = f"T9 tone {tone}{', two panels' if dim else ''}"
        rows.append(_row(f"{name}: recall", float(green_[on & seen].mean()), 0.99))
        rows.append(_row(f"{name}: hand lost", float(green_[~on & seen].mean()), None, 0.01))
        _pictures(found, f"green_{tone}")
    return rows


def _pictures(found: Any, name: str) -> None:
    import cv2

    from synthgen.corpus.scan_pictures import scan_pictures

    for kind, picture in scan_pictures(found).items():
        cv2.imwrite(str(PICTURES / f"{name}_{kind}.png"), picture[..., ::-1])
