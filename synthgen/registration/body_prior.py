"""What a body's pose is before any point is seen: an A-pose, loosely; hands as hands are.

The fingers of a hand live in its principal components. In the early stages only the first six
are free, under a Gaussian mixture (Eq. 17-19, max approximation); in the last stage all 45 angles
are, and the components beyond the sixth keep the spread that they have among the known poses:
without it fingers twist where no point says otherwise.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from synthgen.models import BodyModel
from synthgen.models.joints import SIDES
from synthgen.models.model import HandSpace
from synthgen.registration.body_surface import BodySurface
from synthgen.registration.terms import GaussianPrior, MixturePrior, Term, shape_prior
from synthgen.sampling.body_pose import a_pose

Array = NDArray[np.float64]
PCA, COMPONENTS = 6, 10
# Least spread of a component beyond the sixth, radians: no table of poses is complete.
LEAST_SD_RAD = 0.06
# Standard deviations of joint angles about the A-pose, radians.
JOINT_SD_RAD = {
    "spine": 0.15, "neck": 0.25, "head": 0.25, "collar": 0.12, "shoulder": 0.6, "elbow": 0.7,
    "wrist": 0.3, "hip": 0.4, "knee": 0.5, "ankle": 0.2, "foot": 0.05, "jaw": 0.05, "toe": 0.07,
}  # fmt: skip
# Joints that no scan determines: they stay at rest.
STILL = ("left_eye", "right_eye")


@dataclass(frozen=True, eq=False)
class HandPriors:
    """Pose space and priors of one hand's 45 angles.

    Attributes
    ----------
    mean : (45,), components : (45, 6)
        The reduced hand is ``mean + components z``.
    more : (45, 12)
        Twice as many components.
    mixture : MixturePrior
        Over the first six components.
    complement : MixturePrior
        One component: independent normals of the others.
    """

    mean: Array
    components: Array
    more: Array
    mixture: MixturePrior
    complement: MixturePrior

    @property
    def typical(self) -> Array:
        """Poses (k, 45) of the mixture's means, where restarts begin."""
        return self.mixture.means


@dataclass(frozen=True, eq=False)
class BodyPriors:
    """Priors of a body.

    Attributes
    ----------
    start : (n,) float64
        The A-pose with mean hands and shape, at the origin.
    joints : (m,) int64
        Angles in the vector that the pose prior holds: all but the root, fingers and ``STILL``.
    sd : (m,) radians
    hands : dict of str to HandPriors
        By side.
    """

    start: Array
    joints: NDArray[np.int64]
    sd: Array
    hands: dict[str, HandPriors]
    surface: BodySurface

    def pose_terms(self, weight: float = 1.0) -> list[Term]:
        """Return the prior of the joints about the A-pose."""
        return [GaussianPrior(self.joints, self.start[self.joints], self.sd, weight)]

    def hand_terms(self, sides: Sequence[str] = SIDES) -> list[Term]:
        """Return the priors of hands."""
        own = [self.hands[side] for side in sides]
        return [term for h in own for term in (h.mixture, h.complement)]

    def coefficient_terms(self) -> list[Term]:
        """Return the priors of shape and expression."""
        s = self.surface
        terms: list[Term] = [shape_prior(s)]
        if n := s.model.n_expression:
            terms.append(GaussianPrior(s.expression, np.zeros(n), np.ones(n)))
        return terms

    def terms(self) -> list[Term]:
        """Return all priors."""
        return [*self.pose_terms(), *self.hand_terms(), *self.coefficient_terms()]


@lru_cache(maxsize=8)
def body_priors(surface: BodySurface) -> BodyPriors:
    """Return the priors of a body, made once per process."""
    start = np.zeros(surface.n)
    start[surface.pose] = a_pose(surface.model).ravel()
    hands = {side: _hand_priors(surface, side) for side in SIDES}
    for side, hand in hands.items():
        start[surface.hands[side]] = hand.mean
    places, sds = [], []
    fingers = np.concatenate([np.r_[where] for where in surface.hands.values()])
    for k, name in enumerate(surface.model.joint_names):
        at = surface.joint(name)
        if k > 0 and at.start not in fingers and name not in STILL:
            places.append(np.r_[at])
            sds.append(np.full(3, joint_sd(name)))
    return BodyPriors(start, np.concatenate(places), np.concatenate(sds), hands, surface)


def joint_sd(name: str) -> float:
    """Return the standard deviation of a joint's angles, radians."""
    return next(sd for word, sd in JOINT_SD_RAD.items() if word in name)


def _hand_priors(surface: BodySurface, side: str) -> HandPriors:
    where, space = surface.hands[side], known_hands(surface.model, side)
    assert space.coeffs is not None
    to_coefficients = np.linalg.pinv(space.components.T)
    sd = np.maximum(space.coeffs.std(axis=0), LEAST_SD_RAD)
    means, roots, constants = _mixture(space.coeffs[:, :PCA])
    mixture = MixturePrior(
        where,
        means=space.mean + means @ space.components[:PCA],
        whiten=np.einsum("kba,bc->kac", roots, to_coefficients[:PCA]),
        constants=constants,
    )
    beyond = to_coefficients[PCA:] / sd[PCA:, None]
    complement = MixturePrior(where, space.mean[None], beyond[None], np.zeros(1))
    few, more = (space.components[:n].T.copy() for n in (PCA, 2 * PCA))
    return HandPriors(space.mean, few, more, mixture, complement)


def known_hands(model: BodyModel, side: str) -> HandSpace:
    """Return a body's own hand poses, or cc0-body's: joint frames are those of all such models."""
    from synthgen.models import load

    own = model.hand_space("left" if side == "left" else "right")
    known = None if own is None else own.coeffs
    if known is None or len(known) < COMPONENTS or known.shape[1] < 45:
        own = load("cc0-body").hand_space("left" if side == "left" else "right")
    assert own is not None
    return own


def _mixture(coefficients: Array) -> tuple[Array, Array, Array]:
    """Fit means (k, 6), roots of precisions (k, 6, 6) and constants (k,)."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.mixture import GaussianMixture

    with warnings.catch_warnings(), threadpool_limits(limits=1):
        warnings.simplefilter("ignore", ConvergenceWarning)
        found = GaussianMixture(COMPONENTS, reg_covar=1e-3, random_state=0).fit(coefficients)
    constants = -np.log(found.weights_) + 0.5 * np.linalg.slogdet(found.covariances_)[1]
    return found.means_, found.precisions_cholesky_, constants - constants.min()
