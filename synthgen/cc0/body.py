"""Build ``cc0-body``: a whole body in SMPL+H form, with the hands of ``cc0-hand``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.cc0.body_correctives import (
    joint_geodesics,
    learn_ridge,
    mirror_blocks,
    rotation_feature,
)
from synthgen.cc0.body_poses import known_poses, mixed_turns, single_turns
from synthgen.cc0.dress import attachments
from synthgen.cc0.foundation import Foundation, Progress, seeded
from synthgen.cc0.landmarks import fingers_of, keypoints, masks, parts
from synthgen.cc0.packing import packed_correctives
from synthgen.cc0.skeleton import SMPLH52, Skeleton
from synthgen.cc0.source import MakeHuman

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SHAPES, TRAINING, UNSEEN = 16, 200, 32


def build_body(data: MakeHuman, say: Progress) -> dict[str, Any]:
    """Return every array of the shipped body, in the form of :mod:`synthgen.models.compact`."""
    say("drawing people and taking them to the zero pose")
    base = Foundation.lay(data, SMPLH52, SHAPES)
    say("learning pose correctives")
    blocks, report = _correctives(base)
    say("dressing")
    return {
        "shipped_form": np.array("smplh"),
        **base.packed(),
        **packed_correctives(blocks),
        **attachments(base, None),
        **keypoints(base),
        **masks(base),
        **{f"part_{name}": ids.astype(np.uint16) for name, ids in parts(base).items()},
        "provenance": np.array(base.provenance("cc0-body", report)),
    }


def training_poses(skeleton: Skeleton) -> Array:
    """Poses (n, K, 3) that the correctives are learned on."""
    mixed = mixed_turns(skeleton, TRAINING, rng=seeded("training"))
    return np.concatenate([single_turns(skeleton), mixed])


def unseen_poses(skeleton: Skeleton) -> Array:
    """Poses (n, K, 3) that they are tested on: known ones, then random ones."""
    mixed = mixed_turns(skeleton, UNSEEN, rng=seeded("unseen"))
    return np.concatenate([known_poses(skeleton)[1], mixed])


def _correctives(base: Foundation) -> tuple[Array, dict[str, Any]]:
    """Blocks (V, K, 3, 9): the hand model's for fingers, Eq. 10 regression for the rest."""
    rest, ids = base.rest, base.rest.half
    poses = training_poses(base.skeleton)
    relevant = rest.relevant(ids) & poses.any(axis=(0, 2))
    cost = joint_geodesics(rest.points, base.cut.faces, base.regressor, ids)
    half = learn_ridge(rotation_feature(poses), rest.offsets(poses, ids), relevant, cost)
    report = corrective_report(base, half, rotation_feature)
    own = np.searchsorted(ids, base.cut.hand_ids)
    fingers = np.array([base.skeleton.index(name) for name in fingers_of("right")])
    half[np.ix_(own, fingers)] = hand_blocks(base, base.hand.posedirs, 9)
    mirror = base.cut.mirror[: base.cut.n_body]
    return mirror_blocks(half, ids, mirror, base.skeleton.mirrored), report


def hand_blocks(base: Foundation, posedirs: Array, size: int) -> Array:
    """Return the hand model's correctives as blocks (H, 15, 3, size), scaled to the body's hand."""
    ours = base.template[base.cut.hand_ids]
    scale = np.ptp(ours[:, 0]) / np.ptp(base.hand.v_template[:, 0])
    return np.asarray(scale * posedirs.reshape(len(ours), 3, 15, size).transpose(0, 2, 1, 3))


def corrective_report(base: Foundation, half: Array, feature: Any) -> dict[str, Any]:
    """Mean distance to the target on unseen poses, without and with correctives."""
    rest, ids = base.rest, base.rest.half
    poses = unseen_poses(base.skeleton)
    wanted = rest.targets(poses, ids)
    values = feature(poses).reshape(len(poses), -1)
    table = half.transpose(1, 3, 0, 2).reshape(values.shape[1], -1)
    offsets = (values @ table).reshape(len(poses), len(ids), 3)
    before = float(np.linalg.norm(rest.skin(poses, ids) - wanted, axis=-1).mean())
    after = float(np.linalg.norm(rest.skin(poses, ids, offsets) - wanted, axis=-1).mean())
    return {
        "correctives_unseen_poses": {
            "skinning_mm": round(1e3 * before, 4),
            "corrected_mm": round(1e3 * after, 4),
            "cut": round(1 - after / before, 4),
        }
    }
