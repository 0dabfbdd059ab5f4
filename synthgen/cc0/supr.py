"""Build ``cc0-supr``: a whole body in SUPR form, with toes, face and feet that give way."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.cc0 import correctives
from synthgen.cc0.body import corrective_report, hand_blocks, training_poses
from synthgen.cc0.body_correctives import learn_activations, mirror_blocks
from synthgen.cc0.dress import attachments
from synthgen.cc0.elastic import ElasticHand
from synthgen.cc0.face import expression_space, packed_face
from synthgen.cc0.feet import foot_networks
from synthgen.cc0.foundation import Foundation, Progress, seeded
from synthgen.cc0.landmarks import fingers_of, keypoints, masks, parts
from synthgen.cc0.packing import packed_correctives
from synthgen.cc0.poses import pose_table, protocol_poses, single_joint_poses
from synthgen.cc0.skeleton import SUPR75
from synthgen.cc0.source import MakeHuman
from synthgen.models import ManoModel
from synthgen.models.pose_features import quaternion_feature
from synthgen.sampling.limits import limits_of

Array = NDArray[np.float64]

SHAPES, HAND_TRAINING, HAND_UNSEEN = 30, 120, 6


def build_supr(data: MakeHuman, say: Progress) -> dict[str, Any]:
    """Return every array of the shipped body, in the form of :mod:`synthgen.models.compact`."""
    say("drawing people and taking them to the zero pose")
    base = Foundation.lay(data, SUPR75, SHAPES)
    say("learning pose correctives")
    blocks, activations, report = _correctives(base, say)
    say("face and dress")
    expressions, units = expression_space(base)
    regions = parts(base)
    feet, feet_report = foot_networks(base, regions["right_foot"], say)
    return {
        "shipped_form": np.array("supr"),
        **base.packed(),
        **packed_correctives(blocks, activations),
        **packed_face(base, expressions, units),
        **attachments(base, expressions),
        **keypoints(base),
        **masks(base),
        **{f"part_{name}": ids.astype(np.uint16) for name, ids in regions.items()},
        **feet,
        "provenance": np.array(base.provenance("cc0-supr", report | feet_report)),
    }


def _correctives(base: Foundation, say: Progress) -> tuple[Array, Array, dict[str, Any]]:
    """Blocks (V, 75, 3, 4) and activations (V, 75): body by targets, fingers by the hand model."""
    rest, ids = base.rest, base.rest.half
    poses = training_poses(base.skeleton)
    relevant = rest.relevant(ids) & poses.any(axis=(0, 2))
    half, active = learn_activations(quaternion_feature(poses), rest.offsets(poses, ids), relevant)
    report = corrective_report(base, half, quaternion_feature)
    say("learning the hands' correctives")
    hand, hand_active = _hand_activations(base.hand)
    own = np.searchsorted(ids, base.cut.hand_ids)
    fingers = np.array([base.skeleton.index(name) for name in fingers_of("right")])
    flat = hand.transpose(0, 2, 1, 3).reshape(len(own), 3, -1)
    half[np.ix_(own, fingers)] = hand_blocks(base, flat, 4)
    active[np.ix_(own, fingers)] = hand_active
    mirror, sides = base.cut.mirror[: base.cut.n_body], base.skeleton.mirrored
    both = np.zeros((base.cut.n_body, len(sides)))
    both[ids] = active
    both = np.maximum(both, both[mirror][:, sides])
    report |= _hand_report(base.hand, hand)
    return mirror_blocks(half, ids, mirror, sides), both, report


def _hand_activations(hand: ManoModel) -> tuple[Array, Array]:
    """Quaternion correctives (H, 15, 3, 4) of a hand from those it has, and activations (H, 15)."""
    limits = limits_of(hand)
    poses = np.concatenate(
        [single_joint_poses(limits), pose_table(limits, HAND_TRAINING, rng=seeded("hand"))]
    )
    offsets = np.einsum("nf,vcf->nvc", correctives.pose_feature(poses), hand.posedirs)
    active = np.asarray(hand.posedirs.reshape(-1, 3, 15, 9).any(axis=(1, 3)))
    return learn_activations(quaternion_feature(poses)[:, 1:], offsets, active)


def _hand_report(hand: ManoModel, blocks: Array) -> dict[str, Any]:
    """Mean distance to elastic targets on unseen hand poses, without and with correctives."""
    limits = limits_of(hand)
    poses = np.concatenate(
        [protocol_poses(limits)[1], pose_table(limits, HAND_UNSEEN, rng=seeded("hand/unseen"))]
    )
    joints = hand.J_regressor @ hand.v_template
    tips = hand.v_template[hand.fingertip_ids[[1, 2, 4, 3, 0]]]
    elastic = ElasticHand(hand.v_template, hand.faces, hand.weights, joints, tips)
    motions = correctives.bone_motions(poses, joints)
    wanted = np.stack([elastic.pose(motion) for motion in motions])
    feature = quaternion_feature(poses)[:, 1:]
    offsets = np.einsum("nkb,vkcb->nvc", feature, blocks, optimize=True)
    distances = [
        float(
            np.linalg.norm(correctives.skinned(p, hand.weights, motions) - wanted, axis=-1).mean()
        )
        for p in (hand.v_template, hand.v_template + offsets)
    ]
    return {
        "hand_correctives_unseen_poses": {
            "skinning_mm": round(1e3 * distances[0], 4),
            "corrected_mm": round(1e3 * distances[1], 4),
            "cut": round(1 - distances[1] / distances[0], 4),
        }
    }
