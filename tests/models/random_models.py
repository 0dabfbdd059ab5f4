"""Random models of every family, and poses for them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import body_files
import numpy as np

from synthgen.models import BodyModel, ConstrainedTree, HandSpace
from synthgen.models.joints import MANO16_NAMES, MANO16_PARENTS
from synthgen.sampling.streams import stream

FAMILIES = ("mano", "smplh", "supr", "supr296", "star", "official", "consistent")


@dataclass(frozen=True)
class Draw:
    """One batch of arguments of ``evaluate``."""

    shape: Any
    pose: Any
    translation: Any
    expression: Any

    def __iter__(self) -> Any:
        return iter((self.shape, self.pose, self.translation, self.expression))

    def one(self, b: int) -> Draw:
        return Draw(*(None if a is None else a[b] for a in self))

    def rows(self, *b: int) -> Draw:
        return Draw(*(None if a is None else a[list(b)] for a in self))


def model(
    kind: str, *, pairs: int = 30, betas: int = 6, seed: int = 0, active: float = 0.15
) -> BodyModel:
    """A model of few vertices; "supr" has expressions and sparse correctives, "supr296" the
    paper's columns, "official" and "consistent" are constrained trees."""
    if kind == "mano":
        return _mano(pairs, betas, seed)
    family = kind if kind in ("smplh", "star") else "supr"
    content = body_files.body(family, pairs=pairs, betas=betas, seed=seed)
    rng = stream(seed, "sample", 0, 0, f"random {kind}")
    names, parents = body_files.NAMES[family]
    v, k = content["weights"].shape
    made = BodyModel(
        name=kind, family=family, digest="", joint_names=names, parents=np.array(parents),
        faces=content["f"].astype(np.int64),
        **{key: content[key] for key in
           ("v_template", "shapedirs", "posedirs", "weights", "J_regressor")},
    )  # fmt: skip
    if kind == "smplh":
        files = body_files.hands(seed)
        left, right = (
            HandSpace(files[f"hands_mean{s}"], files[f"hands_components{s}"]) for s in "lr"
        )
        return replace(made, hands_left=left, hands_right=right)
    if kind == "supr":
        kept = np.repeat(rng.random((v, k)) < active, 4, axis=1)[:, None]
        faces = rng.normal(0, 0.01, (v, 3, 5))
        return replace(made, exprdirs=faces, posedirs=made.posedirs * kept)
    if kind == "supr296":
        return replace(made, posedirs=made.posedirs[..., 4:])
    if kind in ("official", "consistent"):
        tree = ConstrainedTree.from_meta(body_files.axis_meta(k, 20, 8, seed), k)
        return replace(made, axis_meta=tree, constrained=kind)
    return made


def draw(made: BodyModel, n: int, *, seed: int = 0, spread: float = 0.5) -> Draw:
    """n random samples; the second, if any, has the zero pose."""
    rng = stream(seed, "sample", 0, 0, f"draw {made.name}")
    pose = rng.normal(0, spread, (n, len(made.parents), 3))
    if made.axis_meta is not None:
        pose = rng.normal(0, spread, (n, made.n_pose))
    pose[1:2] = 0
    expression = rng.normal(size=(n, made.n_expression)) if made.n_expression else None
    return Draw(rng.normal(size=(n, made.n_shape)), pose, rng.normal(size=(n, 3)), expression)


def _mano(pairs: int, betas: int, seed: int) -> BodyModel:
    rng = stream(seed, "sample", 0, 0, "random mano")
    v, k = 2 * pairs + 8, len(MANO16_PARENTS)
    weights, regressor = rng.random((v, k)) * (rng.random((v, k)) < 0.3), rng.random((k, v))
    weights[:, 0] += 0.1
    return BodyModel(
        name="mano", family="mano", digest="", hand="right", joint_names=MANO16_NAMES,
        parents=np.array(MANO16_PARENTS), faces=rng.integers(0, v, (v, 3)),
        v_template=rng.normal(0, 0.05, (v, 3)), shapedirs=rng.normal(0, 0.005, (v, 3, betas)),
        posedirs=rng.normal(0, 0.001, (v, 3, 9 * (k - 1))),
        weights=weights / weights.sum(axis=1, keepdims=True),
        J_regressor=regressor / regressor.sum(axis=1, keepdims=True),
        hands_mean=rng.normal(0, 0.2, 45),
        hands_components=np.linalg.qr(rng.normal(size=(45, 45)))[0],
    )  # fmt: skip
