"""What the fitter believes about hand poses before it sees a scan.

Learned from the engine's own samplers: poses uniform over the joint limits (fingers independent)
and, where the model carries one, its pose table. Protocol poses stay out, for testing.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from synthgen.models import BodyModel, ManoModel
from synthgen.sampling.limits import JointLimits, limits_of, sample_uniform
from synthgen.sampling.streams import stream

Array = NDArray[np.float64]
COMPONENTS, POSES, PRESETS, TABLE = 10, 5000, 8, 24


@dataclass(frozen=True, eq=False)
class HandPrior:
    """Pose prior of one hand's 45 finger angles (axis-angle, radians, mean included).

    Attributes
    ----------
    means : (10, 45), whiten : (10, 45, 45), constants : (10,)
        Mixture; see :class:`synthgen.registration.terms.MixturePrior`.
    mean : (45,), components : (45, 45), sd : (45,)
        Principal components of the training poses, rows, and their standard deviations.
    fingers : (5, 8, 9)
        Typical poses of single fingers.
    table : (24, 45)
        Typical poses of the hand.
    """

    means: Array
    whiten: Array
    constants: Array
    mean: Array
    components: Array
    sd: Array
    fingers: Array
    table: Array

    def arrays(self) -> dict[str, Array]:
        """Return all arrays by name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}


def training_poses(model: BodyModel, n: int, *, rng: np.random.Generator) -> Array:
    """Draw (n, 45) poses: uniform over the limits, and from the model's table where it has one."""
    assert isinstance(model, ManoModel)
    limits: JointLimits = limits_of(model)
    table = model.hands_coeffs
    from_table = 0 if table is None else int(0.45 * n)
    poses = sample_uniform(limits, rng=rng, n=n - from_table)[:, 1:].reshape(-1, 45)
    if table is not None and model.hands_components is not None and model.hands_mean is not None:
        rows = table[rng.integers(len(table), size=from_table)]
        known = rows @ model.hands_components[: rows.shape[1]] + model.hands_mean
        known = known + rng.normal(0, 0.05, known.shape)
        poses = np.concatenate([poses, known])
    return np.asarray(poses[rng.permutation(len(poses))])


def learn_prior(model: BodyModel) -> HandPrior:
    """Fit mixture, principal components and typical poses; some seconds."""
    from sklearn.cluster import KMeans
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.mixture import GaussianMixture

    rng = stream(0, "corpus", 0, 0, "registration prior")
    poses = training_poses(model, POSES, rng=rng)
    with warnings.catch_warnings(), threadpool_limits(limits=1):
        warnings.simplefilter("ignore", ConvergenceWarning)
        mixture = GaussianMixture(COMPONENTS, reg_covar=1e-3, random_state=0, max_iter=40)
        mixture.fit(poses)
        fingers = np.stack([_centres(KMeans, poses[:, 9 * f : 9 * f + 9], PRESETS)
                            for f in range(5)])  # fmt: skip
        table = _centres(KMeans, poses, TABLE)
    constants = -np.log(mixture.weights_) + 0.5 * np.linalg.slogdet(mixture.covariances_)[1]
    mean = poses.mean(axis=0)
    _, spread, components = np.linalg.svd(poses - mean, full_matrices=False)
    return HandPrior(
        means=mixture.means_,
        whiten=mixture.precisions_cholesky_.transpose(0, 2, 1),
        constants=constants - constants.min(),
        mean=mean,
        components=components,
        sd=spread / np.sqrt(len(poses) - 1),
        fingers=fingers,
        table=table,
    )


def _centres(kmeans: Any, rows: Array, n: int) -> Array:
    return np.asarray(kmeans(n, n_init=1, random_state=0).fit(rows).cluster_centers_)


@lru_cache(maxsize=4)
def learned_prior(model: BodyModel) -> HandPrior:
    """Return :func:`learn_prior`, once per process."""
    return learn_prior(model)
