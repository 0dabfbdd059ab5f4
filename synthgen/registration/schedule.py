"""Coarse-to-fine schedules: what a stage of a fit looks at, and how firmly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError, nearest
from synthgen.registration.scan import Scan
from synthgen.registration.solver import Energy, Method, Outcome, minimise
from synthgen.registration.surface import Surface
from synthgen.registration.terms import GemanMcClure, MeshToScan, ScanToMesh, Term

Array = NDArray[np.float64]
MM = 1e-3
# Stages of so many points take steps so small that matches walk on from the last ones.
WALK_POINTS = 3000


@dataclass(frozen=True)
class Stage:
    """One stage of annealing.

    The data weighs as ``n_eff`` independent points of standard deviation ``noise_m``: it starts
    soft, so that the priors lead, and ends at the scan's own noise (the paper's annealing of
    lambda_a, over a wider range).

    Attributes
    ----------
    points : int
        Scan points used.
    iterations : int
    sigma_m : float
        Geman-McClure scale, metres.
    cut_m : float
        Farthest correspondence, metres.
    cosine : float
        Least cosine between normals.
    noise_m, n_eff : float
    tangential : float
        Share of point-to-point distance.
    mesh_to_scan : float
        Weight of the mesh-to-scan term relative to scan-to-mesh (paper: 0.1).
    mesh_cut_m : float
        Vertices farther than this from the scan lie over holes.
    prior : float
        Weight of the pose prior.
    """

    points: int
    iterations: int
    sigma_m: float
    cut_m: float
    cosine: float
    noise_m: float
    n_eff: float
    tangential: float = 0.0
    mesh_to_scan: float = 0.0
    mesh_cut_m: float = 0.015
    prior: float = 1.0

    def counted(self, points: int) -> float:
        """Return as how many independent points a scan of so many weighs."""
        return self.n_eff * min(points / self.points, 1.0)


S = TypeVar("S", bound=Stage)
CLOSE = Stage(1500, 10, 6 * MM, 30 * MM, 0.3, 0.5 * MM, 300, tangential=0.02, mesh_to_scan=0.2)
NEAR = Stage(3000, 8, 2.5 * MM, 12 * MM, 0.5, 0.3 * MM, 2000, mesh_to_scan=0.1, mesh_cut_m=0.006)
FINAL = Stage(10_000, 8, 1 * MM, 5 * MM, 0.5, 0.2 * MM, 10_000, prior=0.3)
LAST = replace(FINAL, points=50_000, n_eff=50_000, iterations=3, prior=1.0)


@dataclass(frozen=True)
class Preset:
    """A named schedule.

    Attributes
    ----------
    finish : tuple of Stage
        From a good start; the last stage takes the scan's own noise when ``own_noise``.
    method : "lm" or "dogleg"
    """

    name: str
    finish: tuple[Stage, ...]
    method: Method = "lm"
    own_noise: bool = True


def _paper(lambda_a: float, stage: Stage) -> Stage:
    """Stage of the paper (Eq. 12): lambda_a times the data, the pose prior over lambda_a.

    The paper leaves the terms' own weights open: here the mean robust squared distance counts in
    units of (0.2 mm)^2, and the prior is whole at lambda_a = 100.
    """
    return replace(stage, n_eff=lambda_a, noise_m=0.2 * MM, mesh_to_scan=0.1, prior=100 / lambda_a)


PRESETS = {
    "fast": Preset("fast", (CLOSE, NEAR, FINAL, LAST)),
    "accurate": Preset(
        "accurate",
        (CLOSE, NEAR, FINAL, replace(LAST, points=100_000, n_eff=100_000, iterations=6)),
    ),
    "paper": Preset(
        "paper",
        (_paper(100, CLOSE), _paper(300, NEAR), _paper(500, replace(FINAL, points=5000))),
        method="dogleg",
        own_noise=False,
    ),
}


def preset_named(name: str) -> Preset:
    """Return a preset.

    Raises
    ------
    ShapeError
        If there is none of that name.
    """
    if name not in PRESETS:
        known = ", ".join(PRESETS)
        raise ShapeError(f"no preset {name!r}{nearest(name, PRESETS)}; known: {known}")
    return PRESETS[name]


def stage_terms(
    scan: Scan,
    stage: Stage,
    priors: Sequence[Term],
    visible: NDArray[np.bool_] | None = None,
    curved: float = 0.0,
    begin: NDArray[np.int64] | None = None,
) -> list[Term]:
    """Return the terms of one stage; a scan of fewer points than the stage's counts for fewer.

    ``begin`` are vertices near the points' closest ones, where they are known.
    """
    points, normals = scan.points[: stage.points], scan.normals[: stage.points]
    weight = stage.counted(len(points)) / stage.noise_m**2
    rho = GemanMcClure(stage.sigma_m)
    memory: dict[str, NDArray[np.int64]] | None = None
    if stage.points >= WALK_POINTS:
        memory = {} if begin is None else {"corner": begin}
    terms: list[Term] = [
        ScanToMesh(
            points,
            normals,
            weight,
            rho,
            stage.cut_m,
            stage.cosine,
            stage.tangential,
            curved,
            memory=memory,
        )
    ]
    if stage.mesh_to_scan > 0:
        terms.append(
            MeshToScan(scan, weight * stage.mesh_to_scan, rho, stage.mesh_cut_m,
                       max(stage.cosine, 0.3), visible)
        )  # fmt: skip
    return [*terms, *priors]


def pca_basis(surface: Surface, components: int) -> Array:
    """Directions of everything but the fingers, and the hand's leading principal components.

    Parameters
    ----------
    surface : Surface
        Of a hand model with ``hands_components``.
    components : int
        6 to 45.
    """
    directions = surface.model.hands_components
    if directions is None or not 6 <= components <= len(directions):
        most = 0 if directions is None else len(directions)
        raise ShapeError(
            f"components={components}: model {surface.model.name!r} carries {most}; use 6 to {most}"
        )
    others = np.delete(np.eye(surface.n), np.arange(surface.fingers.start, surface.fingers.stop), 1)
    hand = np.zeros((surface.n, components))
    hand[surface.fingers] = directions[:components].T
    return np.concatenate([others, hand], axis=1)


def pca_origin(surface: Surface) -> Array:
    """Return the vector (n,) that the directions of :func:`pca_basis` start at: the mean hand."""
    x = np.zeros(surface.n)
    mean = surface.model.hands_mean
    if mean is not None:
        x[surface.fingers] = np.asarray(mean, dtype=np.float64).ravel()
    return x


def run_stage(
    surface: Surface,
    scan: Scan,
    x: Array,
    stage: Stage,
    priors: Sequence[Term],
    *,
    method: Method = "lm",
    basis: Array | None = None,
    visible: NDArray[np.bool_] | None = None,
    curved: float = 0.0,
    begin: NDArray[np.int64] | None = None,
) -> Outcome:
    """Run one stage from x."""
    energy = Energy(surface, stage_terms(scan, stage, priors, visible, curved, begin))
    return minimise(energy, x, iterations=stage.iterations, basis=basis, method=method)


def own_noise(outcome: Outcome, points: int | None = None) -> float:
    """Return the sd of a scan (its first points) about a fit, from the median of kept distances."""
    pairs = outcome.trial.matches[0]
    squared = pairs.squared[:points][pairs.kept[:points]]
    if len(squared) == 0:
        return 2e-4
    return float(np.clip(np.sqrt(np.median(squared)) / 0.6745, 1e-4, 2e-3))


def last_stage(stage: S, noise_m: float) -> S:
    """Return the final stage at a scan's own noise."""
    return replace(stage, noise_m=noise_m, sigma_m=max(stage.sigma_m, 4 * noise_m),
                   cut_m=max(stage.cut_m, 12 * noise_m))  # fmt: skip
