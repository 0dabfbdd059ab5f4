"""What both bodies are built on: people, template, shape space, weights and regressor."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen import __version__
from synthgen.cc0.body_targets import RestBody
from synthgen.cc0.bodyskin import merged_weights, owners
from synthgen.cc0.packing import (
    packed_regressor,
    packed_uv,
    packed_weights,
    quantised,
)
from synthgen.cc0.population import Bodies, BodyCut, cut_body, populate_bodies
from synthgen.cc0.skeleton import SUPR75, Skeleton
from synthgen.cc0.source import WHEEL, WHEEL_SHA256, MakeHuman
from synthgen.models import ManoModel, load_hand
from synthgen.sampling.streams import stream

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Progress = Callable[[str], None]

SEED, PEOPLE = 1, 400


@dataclass(frozen=True, eq=False)
class Foundation:
    """One family's skeleton on the common body.

    Attributes
    ----------
    source, hand, cut, bodies
        Data, hand model, topology and people.
    skeleton : Skeleton
    n_shapes : int
    """

    source: MakeHuman
    hand: ManoModel
    cut: BodyCut
    bodies: Bodies
    skeleton: Skeleton
    n_shapes: int

    @staticmethod
    def lay(source: MakeHuman, skeleton: Skeleton, n_shapes: int) -> Foundation:
        """Draw the people; both families see the same ones."""
        hand = load_hand("cc0-hand")
        cut = cut_body(source, hand)
        people = populate_bodies(source, cut, hand, PEOPLE, rng=seeded("people"))
        return Foundation(source, hand, cut, people, skeleton, n_shapes)

    @cached_property
    def template(self) -> Array:
        """Mean person, body then extras, (S, 3), metres."""
        return np.asarray(self.bodies.vertices.mean(axis=0))

    @cached_property
    def _scores(self) -> tuple[Array, Array]:
        """Unit-variance scores (n, n_shapes) of the people and the variance explained."""
        n = len(self.bodies.vertices)
        centred = (self.bodies.vertices - self.template)[:, : self.cut.n_body].reshape(n, -1)
        values, vectors = np.linalg.eigh(centred @ centred.T)
        scores = vectors[:, ::-1][:, : self.n_shapes] * np.sqrt(n - 1)
        # a positive beta makes taller
        scores *= np.sign(scores.T @ (self.bodies.stature - self.bodies.stature.mean()))
        return scores, np.cumsum(values[::-1])[: self.n_shapes] / values.sum()

    @cached_property
    def shapes(self) -> Array:
        """Shape components (S, 3, n_shapes), metres per standard deviation."""
        n = len(self.bodies.vertices)
        centred = (self.bodies.vertices - self.template).reshape(n, -1)
        bases = (self._scores[0].T @ centred / (n - 1)).reshape(self.n_shapes, -1, 3)
        return np.ascontiguousarray(bases.transpose(1, 2, 0))

    @cached_property
    def regressor(self) -> Array:
        """Sparse regressor (K, V) of the skeleton's joints."""
        return self.bodies.regressor[[SUPR75.index(name) for name in self.skeleton.names]]

    @cached_property
    def joints(self) -> Array:
        """Rest joints (K, 3) of the template, metres."""
        return self.regressor @ self.template[: self.cut.n_body]

    @cached_property
    def _owner(self) -> Ints:
        parents = {bone: entry["parent"] for bone, entry in self.source.bones().items()}
        return owners(self.cut, self.skeleton, parents)

    @cached_property
    def weights(self) -> Array:
        """Skinning weights (S, K) of body and extras."""
        return merged_weights(self.cut, self.skeleton, self._owner, self.template, self.joints)

    @cached_property
    def rest(self) -> RestBody:
        """The template as the correctives' learners see it."""
        n = self.cut.n_body
        return RestBody(
            self.skeleton, self.template[:n], self.joints, self.weights[:n], self._owner, self.cut
        )

    def packed(self) -> dict[str, Any]:
        """Pack what both forms share."""
        n = self.cut.n_body
        parents = np.array(self.skeleton.parents, dtype=np.int64)
        used, uv_faces = np.unique(self.cut.texture, return_inverse=True)
        mean, components = self.hand.hands_mean, self.hand.hands_components
        coeffs = self.hand.hands_coeffs
        assert mean is not None and components is not None and coeffs is not None
        return {
            "v_template": self.template[:n].astype(np.float32),
            **quantised("shapedirs", self.shapes[:n]),
            **packed_weights(self.weights[:n]),
            **packed_regressor(self.regressor),
            "kintree_table": np.stack([parents, np.arange(len(parents))]),
            "f": self.cut.faces.astype(np.uint32),
            "joint_names": np.array(self.skeleton.names),
            "hands_mean": mean,
            "hands_components": components,
            "hands_coeffs": coeffs.astype(np.float32),
            **packed_uv(self.source.texture[used]),
            "uv_faces": uv_faces.reshape(-1, 3).astype(np.uint16),
        }

    def provenance(self, model: str, measured: dict[str, Any]) -> str:
        """Say what was made from what, and how well it does."""
        explained = self._scores[1]
        said = {
            "model": model,
            "licence": "CC0-1.0 (MakeHuman data); built by synthgen",
            "source": WHEEL,
            "wheel_sha256": WHEEL_SHA256,
            "source_sha256": self.source.fingerprint("mpfb2/targets", "faceunits01/targets"),
            "hand": self.hand.digest,
            "seed": SEED,
            "builder": f"synthgen {__version__}",
            "people": PEOPLE,
            "stature_m": [round(float(x), 4) for x in _spread(self.bodies.stature)],
            "shape_variance": [round(float(v), 5) for v in explained],
            **measured,
        }
        return json.dumps(said, sort_keys=True)


def _spread(values: Array) -> tuple[float, float]:
    return float(values.mean()), float(values.std())


def seeded(name: str) -> np.random.Generator:
    """Random stream of one step of the bodies' building."""
    return stream(SEED, "corpus", 0, 0, f"cc0-body/{name}")
