"""Hand poses: a Gaussian mixture in PCA space, mixed with poses uniform over the joint limits.

The mixture is the hand pose distribution of Embodied Hands (Eq. 17-19, N = 10 components), fitted
to the model's own ``hands_coeffs``, here in its leading principal components.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from synthgen.errors import SamplingError
from synthgen.models import ManoModel
from synthgen.sampling.limits import JointLimits, clamp, sample_uniform, violation

# A mixture sample that leaves the limits by less than this is clamped, beyond it is redrawn.
CLAMP_RAD = np.deg2rad(5.0)
MAX_TRIES = 200


@dataclass(frozen=True, eq=False)
class HandPosePrior:
    """Gaussian mixture over the leading PCA coefficients of a hand model.

    Attributes
    ----------
    mean : (45,) float64
        Mean pose, axis-angle, radians.
    basis : (d, 45) float64
        Leading rows of ``hands_components``.
    weights : (n,) float64
    means : (n, d) float64
    cholesky : (n, d, d) float64
        Lower factors of the components' covariances.
    """

    mean: NDArray[np.float64]
    basis: NDArray[np.float64]
    weights: NDArray[np.float64]
    means: NDArray[np.float64]
    cholesky: NDArray[np.float64]

    def sample(self, *, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw one pose, (16, 3) axis-angle with the mean included and a zero root."""
        which = int(np.searchsorted(np.cumsum(self.weights), rng.random() * self.weights.sum()))
        which = min(which, len(self.weights) - 1)
        coefficients = self.means[which] + self.cholesky[which] @ rng.standard_normal(
            self.means.shape[1]
        )
        fingers = self.mean + coefficients @ self.basis
        return np.concatenate([np.zeros((1, 3)), fingers.reshape(-1, 3)])


def fit_prior(model: ManoModel, *, components: int = 10, dimensions: int = 15) -> HandPosePrior:
    """Fit the mixture to the pose table that the model's file carries.

    Parameters
    ----------
    model : ManoModel
        With ``hands_mean``, ``hands_components`` and ``hands_coeffs``.
    components : int
        Number of Gaussians.
    dimensions : int
        Leading principal components that the mixture lives in; the rest stay at the mean.

    Raises
    ------
    SamplingError
        If the model carries no pose table or one that is too small for the mixture.
    """
    coeffs = model.hands_coeffs
    if coeffs is None or len(coeffs) < 5 * components or coeffs.shape[1] < dimensions:
        found = "none" if coeffs is None else f"{coeffs.shape[0]} poses x {coeffs.shape[1]}"
        raise SamplingError(
            f"model {model.name!r} carries a pose table of {found}; a mixture of {components} "
            f"Gaussians in {dimensions} dimensions needs at least {5 * components} poses. "
            "Set pose.gmm_share=0 to draw uniformly over the joint limits instead"
        )
    return _fit(model, components, dimensions)


def _fit(model: ManoModel, components: int, dimensions: int) -> HandPosePrior:
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.mixture import GaussianMixture

    assert model.hands_coeffs is not None
    assert model.hands_mean is not None
    assert model.hands_components is not None
    table = np.asarray(model.hands_coeffs[:, :dimensions], dtype=np.float64)
    mixture = GaussianMixture(components, reg_covar=1e-3, random_state=0, max_iter=200)
    # One thread: sums in another order would give other poses on other machines.
    with warnings.catch_warnings(), threadpool_limits(limits=1):
        warnings.simplefilter("ignore", ConvergenceWarning)
        mixture.fit(table)
    return HandPosePrior(
        mean=np.asarray(model.hands_mean, dtype=np.float64),
        basis=np.asarray(model.hands_components[:dimensions], dtype=np.float64),
        weights=mixture.weights_,
        means=mixture.means_,
        cholesky=np.linalg.cholesky(mixture.covariances_),
    )


@lru_cache(maxsize=8)
def prior_of(model: ManoModel, components: int, dimensions: int) -> HandPosePrior:
    """Return :func:`fit_prior` of a model, fitted once per process."""
    return fit_prior(model, components=components, dimensions=dimensions)


def sample_hand_pose(
    limits: JointLimits,
    prior: HandPosePrior | None,
    *,
    gmm_share: float,
    rng: np.random.Generator,
) -> tuple[NDArray[np.float64], str]:
    """Draw one hand pose within the joint limits.

    Parameters
    ----------
    limits : JointLimits
        Of the model's right hand.
    prior : HandPosePrior or None
        Needed when ``gmm_share`` > 0.
    gmm_share : float
        Probability of the mixture, 0..1; otherwise uniform over the limits.

    Returns
    -------
    pose : (16, 3) float64
        Axis-angle, root zero; violates no limit.
    source : {"gmm", "uniform"}

    Raises
    ------
    SamplingError
        If the mixture does not meet the limits within 200 draws.
    """
    if prior is None or rng.random() >= gmm_share:
        return sample_uniform(limits, rng=rng, n=1)[0], "uniform"
    for _ in range(MAX_TRIES):
        pose = prior.sample(rng=rng)
        if violation(limits, pose).max() <= CLAMP_RAD:
            return clamp(limits, pose), "gmm"
    raise SamplingError(
        f"no mixture pose came within {np.rad2deg(CLAMP_RAD):.0f} degrees of the joint limits in "
        f"{MAX_TRIES} draws; the pose table and the limits do not belong together"
    )
