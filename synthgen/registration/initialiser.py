"""The learned initialiser: from 128 scan points to a few hypotheses, in NumPy.

A PointNet of about 0.4 M weights, batch norms folded, whose K outputs are rotation (6-D), centre
offset, 15 pose coefficients and size. It belongs to one model: the file carries the model's
digest. It is trained by ``synthgen train-init`` (:mod:`synthgen.torch.train_initialiser`).
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

import numpy as np

from synthgen.errors import ModelError
from synthgen.models import BodyModel
from synthgen.registration.coarse_model import COMPONENTS, Single, Starts
from synthgen.registration.prior import HandPrior

POINTS, SCALE_M, HYPOTHESES, POSE_OUT = 128, 0.060, 4, 15
LAYERS = ("point1", "point2", "joint1", "joint2", "head1", "head2", "out")
FORMAT = 1


@dataclass(frozen=True, eq=False)
class Initialiser:
    """Weights (rows are inputs) and the prior that its pose coefficients refer to.

    Attributes
    ----------
    digest : str
        Of the model it belongs to.
    weights : dict of (in, out) float32, biases : dict of (out,) float32
    prior : HandPrior
    """

    digest: str
    weights: dict[str, Single]
    biases: dict[str, Single]
    prior: HandPrior

    @property
    def n_weights(self) -> int:
        """Number of weights and biases."""
        return sum(w.size for w in (*self.weights.values(), *self.biases.values()))

    def forward(self, x: Single) -> Single:
        """Return outputs (B, K, 25) of point sets (B, 128, 6): position / 60 mm, normal."""
        b, n, _ = x.shape
        y = self._layer("point2", self._layer("point1", x.reshape(b * n, 6)))
        most = y.reshape(b, n, -1).max(axis=1)
        y = np.concatenate([y, np.repeat(most, n, axis=0)], axis=1)
        y = self._layer("joint2", self._layer("joint1", y)).reshape(b, n, -1)
        pooled = np.concatenate([y.max(axis=1), y.mean(axis=1)], axis=1)
        hidden = self._layer("head2", self._layer("head1", pooled))
        out = hidden @ self.weights["out"] + self.biases["out"]
        return np.asarray(out.reshape(b, HYPOTHESES, -1), dtype=np.float32)

    def _layer(self, name: str, x: Single) -> Single:
        return np.asarray(np.maximum(x @ self.weights[name] + self.biases[name], 0), np.float32)

    def starts(self, points: Single, normals: Single, turns: Single, n_shape: int) -> Starts:
        """Hypotheses for a scan seen under several rotations ``turns`` (r, 3, 3): r K starts."""
        p, n = points[:POINTS], normals[:POINTS]
        if len(p) < POINTS:
            again = np.resize(np.arange(len(p)), POINTS)
            p, n = p[again], n[again]
        centre = p.mean(axis=0)
        at = np.einsum("rij,nj->rni", turns, p - centre) / SCALE_M
        facing = np.einsum("rij,nj->rni", turns, n)
        out = self.forward(np.concatenate([at, facing], axis=2).astype(np.float32))
        back = np.repeat(turns, HYPOTHESES, axis=0).transpose(0, 2, 1)
        flat = out.reshape(len(back), -1)
        rotation = back @ rotation_from_6d(flat[:, :6])
        translation = (back @ (flat[:, 6:9, None] * SCALE_M))[..., 0] + centre
        coefficients = np.zeros((len(flat), COMPONENTS), np.float32)
        coefficients[:, :POSE_OUT] = np.clip(flat[:, 9 : 9 + POSE_OUT], -3, 3)
        shape = np.zeros((len(flat), n_shape), np.float32)
        shape[:, 0] = np.clip(flat[:, 9 + POSE_OUT], -2.5, 2.5)
        return Starts(rotation, translation.astype(np.float32), coefficients, shape)

    def save(self, path: Path) -> None:
        """Write an npz."""
        arrays = {f"weight_{k}": v for k, v in self.weights.items()}
        arrays |= {f"bias_{k}": v for k, v in self.biases.items()}
        arrays |= {f"prior_{k}": v.astype(np.float32) for k, v in self.prior.arrays().items()}
        path.parent.mkdir(parents=True, exist_ok=True)
        meta = {"digest": np.array(self.digest), "format": np.array(FORMAT)}
        np.savez_compressed(path, allow_pickle=False, **arrays, **meta)


def rotation_from_6d(six: Single) -> Single:
    """Gram-Schmidt of two directions (..., 6), offset so that zeros are the identity."""
    a = six[..., :3] + np.array([1, 0, 0], np.float32)
    b = six[..., 3:] + np.array([0, 1, 0], np.float32)
    x = a / np.linalg.norm(a, axis=-1, keepdims=True)
    y = b - np.sum(x * b, axis=-1, keepdims=True) * x
    y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=-1).astype(np.float32)


def load_initialiser(path: Path) -> Initialiser:
    """Read an initialiser.

    Raises
    ------
    ModelError
        If the file is not one.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            data = {name: stored[name] for name in stored.files}
        if int(data["format"]) != FORMAT:
            raise ValueError(f"format {int(data['format'])}, expected {FORMAT}")
        weights = {name: data[f"weight_{name}"] for name in LAYERS}
        biases = {name: data[f"bias_{name}"] for name in LAYERS}
        prior = HandPrior(**{k[6:]: v.astype(np.float64) for k, v in data.items()
                             if k.startswith("prior_")})  # fmt: skip
        return Initialiser(str(data["digest"]), weights, biases, prior)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ModelError(
            f"{path}: not an initialiser ({error}); make it again with `synthgen train-init MODEL`"
        ) from error


def initialiser_path(model: BodyModel) -> Path:
    """Where ``train-init`` keeps the initialiser of a model: the user's cache, by digest."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    return cache / "synthgen" / "initialisers" / f"{model.digest[:32]}.npz"


@lru_cache(maxsize=4)
def initialiser_of(model: BodyModel) -> Initialiser | None:
    """Return the initialiser of a model: the user's own, else the shipped one, else None."""
    shipped = Path(str(files("synthgen.registration"))) / "data"
    for path in (initialiser_path(model), *sorted(shipped.glob("*.npz"))):
        if path.is_file():
            found = load_initialiser(path)
            if found.digest == model.digest:
                return found
    return None
