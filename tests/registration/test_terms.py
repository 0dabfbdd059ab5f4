"""Every term: residuals, derivatives by finite differences at a frozen match, robust costs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from synthgen.registration.correspondences import Pairs, closest
from synthgen.registration.limit_term import LimitPrior, angle_slopes
from synthgen.registration.prior import learned_prior
from synthgen.registration.scan import Scan
from synthgen.registration.surface import Placed
from synthgen.registration.terms import (
    GaussianPrior,
    GemanMcClure,
    KeypointTerm,
    MeshToScan,
    MixturePrior,
    ScanToMesh,
    Term,
    shape_prior,
    velocity_prior,
)
from synthgen.sampling.limits import limits_of, to_angles
from tests.registration.hands import model, rng, scan, surface, truth

RHO = GemanMcClure(2e-3)
Array = NDArray[np.float64]


def near_truth() -> np.ndarray:
    return (
        truth() + rng("near").normal(0, 0.02, surface().n) * np.r_[np.ones(58), 0.05 * np.ones(3)]
    )


def terms() -> dict[str, Term]:
    s, prior = surface(), learned_prior(model())
    p, n = scan().points[:500], scan().normals[:500]
    return {
        "scan to mesh": ScanToMesh(p, n, 1.0, RHO, 0.03, 0.3, tangential=0.2),
        "scan to curved mesh": ScanToMesh(p, n, 1.0, RHO, 0.03, 0.3, curved=0.75),
        "mesh to scan": MeshToScan(scan(), 0.1, RHO, 0.015, 0.3),
        "mixture": MixturePrior(s.fingers, prior.means, prior.whiten, prior.constants),
        "shape": shape_prior(s),
        "velocity": velocity_prior(s.pose, truth(), np.full(48, 0.03)),
        "protocol": GaussianPrior(s.fingers, np.zeros(45), np.full(45, 0.2)),
        "limits": LimitPrior(s.pose, limits_of(model())),
        "keypoints": KeypointTerm(np.arange(16), s.at(truth()).joints, 2e-3),
    }


def residuals(term: Term, x: np.ndarray, match: Any) -> list[np.ndarray]:
    return [block.residual for block in term.blocks(surface().at(x), match)]


def frozen_plane_residual(placed: Placed, term: ScanToMesh, match: Pairs) -> np.ndarray:
    """Residual with everything of the match frozen, as the step sees it."""
    corners = placed.vertices[match.triangle]
    offset = np.einsum("mk,mka->ma", match.barycentric, corners) + match.shift - term.points
    return np.asarray(np.sum(offset * match.normal, axis=1))


@pytest.mark.parametrize("name", list(terms()))
def test_reference_jacobian_by_finite_differences(name: str) -> None:
    term, x, h = terms()[name], near_truth(), 1e-6
    placed = surface().at(x)
    match = term.match(placed)
    blocks = term.blocks(placed, match)
    assert blocks
    for k in range(0, surface().n, 4):
        step = np.zeros(surface().n)
        step[k] = h
        ahead, behind = residuals(term, x + step, match), residuals(term, x - step, match)
        for block, a, b in zip(blocks, ahead, behind, strict=True):
            scale = max(1.0, float(np.abs(block.rows[:, k]).max(initial=0)))
            np.testing.assert_allclose(block.rows[:, k], (a - b) / (2 * h), atol=2e-6 * scale)


def test_properties_cost_is_zero_at_perfection() -> None:
    """But for the rim, which costs the plateau."""
    s = surface()
    placed, rest = s.at(truth()), s.at(np.zeros(s.n))
    inner = ~s.rim
    whole = Scan(placed.vertices[inner], placed.normals[inner])
    forth = ScanToMesh(whole.points, whole.normals, 1.0, RHO, 0.03, 0.3)
    back = MeshToScan(whole, 0.1, RHO, 0.015, 0.3)
    assert forth.cost(placed, forth.match(placed)) < 1e-20
    plateau = 0.1 * RHO.sigma_m**2 * s.rim.mean()
    assert back.cost(placed, back.match(placed)) == pytest.approx(plateau)
    for name in ("velocity", "keypoints"):
        assert terms()[name].cost(placed, None) == pytest.approx(0, abs=1e-20)
    for name in ("shape", "protocol", "limits"):
        assert terms()[name].cost(rest, None) == 0


def test_reference_cost_of_the_scan_is_the_robust_mean_of_its_distances() -> None:
    """Eq. 6 and 14 by libigl, from both sides of the cut; beyond the rim nothing is said."""
    import igl

    placed = surface().at(near_truth())
    p, n = scan().points[:500], scan().normals[:500]
    squared = igl.point_mesh_squared_distance(p, placed.vertices, surface().faces)[0]
    term = ScanToMesh(p, n, 3.0, RHO, 0.002, -2.0)
    match, s2 = term.match(placed), RHO.sigma_m**2
    kept = squared < 0.002**2
    assert 0.1 < kept.mean() < 0.9
    assert match.rim.any()
    robust = np.where(kept, s2 * squared / (s2 + squared), s2)
    assert term.cost(placed, match) == pytest.approx(3.0 * np.average(robust, weights=match.inner))


def test_properties_points_beyond_the_rim_say_nothing() -> None:
    """A scanned forearm neither costs nor pulls, unless most of the scan is beyond the wrist."""
    placed, s2 = surface().at(near_truth()), RHO.sigma_m**2
    own = scan().points[:500][closest_inner(placed)]
    normals = scan().normals[:500][closest_inner(placed)]
    arm = placed.vertices[surface().rim].mean(axis=0) + 0.02 * forearm(placed)

    def priced(beyond: int) -> tuple[float, Array]:
        p = np.concatenate([own, np.tile(arm, (beyond, 1))])
        n = np.concatenate([normals, np.tile(forearm(placed), (beyond, 1))])
        term = ScanToMesh(p, n, 3.0, RHO, 0.03, 0.3)
        match = term.match(placed)
        assert match.rim[len(own) :].all()
        block = term.blocks(placed, match)[0]
        return term.cost(placed, match), block.rows.T @ (block.weight * block.residual)

    alone, some = priced(0), priced(len(own) // 2)
    assert some[0] == pytest.approx(alone[0])
    np.testing.assert_allclose(some[1], alone[1], rtol=1e-9, atol=1e-9)
    assert priced(9 * len(own))[0] == pytest.approx(3.0 * (0.8 * s2) + 0.2 * alone[0], rel=1e-6)


def closest_inner(placed: Placed) -> NDArray[np.bool_]:
    pairs = closest(placed, scan().points[:500], scan().normals[:500], cut_m=0.03, cosine=0.3)
    return np.asarray(pairs.inner == 1)


def forearm(placed: Placed) -> Array:
    """Direction (3,) from the hand out of its wrist ring."""
    ring = placed.vertices[surface().rim].mean(axis=0)
    off = ring - placed.vertices.mean(axis=0)
    return np.asarray(off / np.linalg.norm(off))


def test_properties_no_energy_leaps_where_a_pair_comes_in() -> None:
    """Costs of scan points are continuous in the pose, across the limit of cosines too."""
    s, h = surface(), 1e-7
    term = ScanToMesh(scan().points[:400], scan().normals[:400], 1.0, RHO, 0.03, 0.5)
    turned, leaps, crossed = near_truth(), [], 0
    for _ in range(60):
        turned[s.fingers.start + 2] += 0.02
        ahead = turned.copy()
        ahead[s.fingers.start + 2] += h
        a, b = (term.match(s.at(x)) for x in (turned, ahead))
        same = a.face == b.face  # a closest point that leaps to other skin has another normal
        crossed += int(np.sum((0 < a.trust) & (a.trust < 1) & same))
        leaps.append(
            np.abs(RHO.cost(a.squared, a.trust) - RHO.cost(b.squared, b.trust))[same].max()
        )
    assert crossed > 20
    assert max(leaps) < 1e-3 * RHO.sigma_m**2


def test_reference_plane_residual() -> None:
    term = terms()["scan to mesh"]
    assert isinstance(term, ScanToMesh)
    placed = surface().at(near_truth())
    match = term.match(placed)
    own = frozen_plane_residual(placed, term, match)
    block = term.blocks(placed, match)[0]
    w = term.point_weights(match)
    np.testing.assert_allclose(block.residual, own[w > 1e-4 * w.max()], atol=1e-12)


def test_reference_geman_mcclure_weight_is_its_slope() -> None:
    squared, kept = np.linspace(0, 1e-4, 9), np.linspace(0.2, 1, 9)
    h = 1e-10
    slope = (RHO.cost(squared + h, kept) - RHO.cost(squared, kept)) / h
    np.testing.assert_allclose(RHO.weight(squared, kept), slope, rtol=1e-3)


def test_properties_rejected_points_cost_the_plateau() -> None:
    """No step can win by losing points: the plateau is the largest cost there is."""
    squared = np.array([1e-8, 1e-4, 1.0])
    lost = RHO.cost(squared, np.zeros(3))
    assert np.all(lost >= RHO.cost(squared, np.ones(3)))
    assert np.all(RHO.weight(squared, np.zeros(3)) == 0)


def test_reference_mixture_takes_the_best_component() -> None:
    term = terms()["mixture"]
    assert isinstance(term, MixturePrior)
    x = near_truth()
    costs = [term.cost(surface().at(x), k) for k in range(len(term.means))]
    assert term.match(surface().at(x)) == int(np.argmin(costs))


def test_reference_limit_angles_by_finite_differences() -> None:
    limits, h = limits_of(model()), 1e-6
    pose = rng("limits").normal(0, 0.4, (16, 3))
    slopes = angle_slopes(limits, pose)
    for axis in range(3):
        step = np.zeros((16, 3))
        step[:, axis] = h
        slope = (to_angles(limits, pose + step) - to_angles(limits, pose - step)) / (2 * h)
        np.testing.assert_allclose(slopes[1:, :, axis], slope[1:], atol=1e-7)


def test_edge_within_the_limits_costs_nothing() -> None:
    x = np.zeros(surface().n)
    term = terms()["limits"]
    assert term.cost(surface().at(x), None) == 0
    assert term.blocks(surface().at(x), None)[0].rows.shape == (0, surface().n)
