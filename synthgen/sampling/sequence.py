"""Short sequences of poses for tracking: smooth, at people's speeds, of one shape throughout.

Body and hands each go from pose to pose at their own pace. Between two poses every angle follows
half a cosine, and so many frames are spent as the speeds allow.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from synthgen.errors import SamplingError
from synthgen.models import BodyModel
from synthgen.models.hand_pca import finger_joints
from synthgen.sampling.body_contact import limbs_inside
from synthgen.sampling.body_pose import (
    INSIDE_SHARE,
    MAX_TRIES,
    hands_of,
    sample_body_pose,
    sample_fingers,
    spreads,
    upright,
)
from synthgen.sampling.shape import sample_shape

if TYPE_CHECKING:
    from synthgen.models.model import Hand

Array = NDArray[np.float64]
# Standard deviations about a sequence's place: turn about the vertical, lean (degrees), metres.
TURN_DEG, LEAN_DEG, WANDER_M = 8.0, 2.0, 0.06
# Mean change of a coordinate from frame to frame.
STEP_M = 0.003
# A hand alone turns and wanders more.
HAND_TURN_DEG = 25.0
SHAPE_LIMIT = 2.0


@dataclass(frozen=True)
class SequenceSettings:
    """How a sequence moves.

    Attributes
    ----------
    frames : int
    body_deg, hand_deg : float
        Mean change of an angle (one axis of a joint of the body, of a finger) from frame to frame.
    most_deg : float
        Largest change of any angle from frame to frame.
    spread : float
        Of the poses on the way; see :func:`synthgen.sampling.body_pose.sample_body_pose`.
    first_spread : float
        Of the first pose: near an A-pose, from which a cold start is sure.
    missing : mapping of "left" or "right" to (first, stop)
        Frames in which a hand is not seen.
    """

    frames: int = 30
    body_deg: float = 0.5
    hand_deg: float = 0.8
    most_deg: float = 10.0
    spread: float = 0.8
    first_spread: float = 0.3
    missing: Mapping[str, tuple[int, int]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PoseSequence:
    """One subject in motion.

    Attributes
    ----------
    shape : (nb,) float64
    pose : (F, K, 3) float64
        Axis-angle, radians.
    translation : (F, 3) float64
        Metres; a body's lowest point is on the floor, y = 0.
    missing : mapping of side to (F,) bool
        Whether a hand is not seen.
    """

    shape: Array
    pose: Array
    translation: Array
    missing: Mapping[str, NDArray[np.bool_]]

    def __len__(self) -> int:
        return len(self.pose)

    def vertices(self, model: BodyModel) -> Array:
        """Return the skin (F, V, 3), metres."""
        betas = np.repeat(self.shape[None], len(self), axis=0)
        posed = model.evaluate(betas, self.pose, self.translation)
        return posed.vertices.astype(np.float64)


def sample_sequence(
    model: BodyModel,
    settings: SequenceSettings,
    *,
    rng: np.random.Generator,
    shape: NDArray[np.floating] | None = None,
) -> PoseSequence:
    """Draw a sequence of a body, or of a hand alone.

    Parameters
    ----------
    model : BodyModel
        A whole body or a hand, in axis-angle.
    settings : SequenceSettings
    rng : numpy.random.Generator
        The sequence is a function of it alone.
    shape : (nb,) float or None
        None: drawn, independent normals within two standard deviations.

    Raises
    ------
    SamplingError
        If a number of the settings is out of its range, or frames are missing that do not exist.
    """
    missing = _checked(model, settings)
    most = np.deg2rad(settings.most_deg)
    betas = sample_shape(model.n_shape, sigma=1.0, limit=SHAPE_LIMIT, rng=rng)
    betas = betas if shape is None else np.asarray(shape, dtype=np.float64)
    if model.hand is None:
        pose = _body(model, betas, settings, rng)
    else:
        pose = np.zeros((settings.frames, len(model.joint_names), 3))
    sides: tuple[Hand, ...] = hands_of(model) if model.hand is None else (model.hand,)
    for side in sides:
        fingers = _track(lambda s=side: sample_fingers(model, s, rng=rng),  # type: ignore[misc]
                         settings.frames, np.deg2rad(settings.hand_deg), most)  # fmt: skip
        pose[:, finger_joints(model, side)] = fingers
    pose[:, 0], translation = _place(model, settings, rng)
    drawn = PoseSequence(betas, pose, translation, missing)
    return drawn if model.hand is not None else _grounded(model, drawn)


def _body(
    model: BodyModel, shape: Array, settings: SequenceSettings, rng: np.random.Generator
) -> Array:
    """Move all joints (F, K, 3) but root and fingers."""
    moving = np.asarray(spreads(model).any(axis=1))  # neither root nor fingers
    before: list[Array] = []

    def draw() -> Array:
        for _ in range(MAX_TRIES):
            spread = settings.spread if before else settings.first_spread
            pose = sample_body_pose(model, spread, rng=rng, shape=shape)
            if not before or limbs_inside(model, shape, (before[-1] + pose) / 2) <= INSIDE_SHARE:
                before.append(pose)
                return pose[moving]
        raise SamplingError(f"no way between poses keeps clear of the body in {MAX_TRIES} draws")

    pose = np.zeros((settings.frames, len(moving), 3))
    body, most = np.deg2rad(settings.body_deg), np.deg2rad(settings.most_deg)
    pose[:, moving] = _track(draw, settings.frames, body, most)
    return pose


def _track(draw: Callable[[], Array], frames: int, mean: float, most: float) -> Array:
    """Go (frames, J, 3) from draw to draw, by ``mean`` a frame and number, by ``most`` at most."""
    here = draw()
    path, left = [here[None]], frames - 1
    while left > 0:
        there = draw()
        change = np.abs(there - here)
        steps = max(change.mean() / mean, np.pi / 2 * change.max() / most)
        count = max(1, int(np.ceil(steps)))
        share = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, count + 1) / count)
        path.append(here + share[:left, None, None] * (there - here))
        here, left = there, left - count
    return np.concatenate(path)


def _place(
    model: BodyModel, settings: SequenceSettings, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Root rotations (F, 3) and translations (F, 3) around a drawn heading and place."""
    hand = model.hand is not None
    wide = np.deg2rad([HAND_TURN_DEG] * 3 if hand else [LEAN_DEG, TURN_DEG, LEAN_DEG])
    first = Rotation.random(rng=rng) if hand else Rotation.from_rotvec(upright(rng=rng))
    body, most = np.deg2rad(settings.body_deg), np.deg2rad(settings.most_deg)
    turn = _track(lambda: wide * rng.standard_normal((1, 3)), settings.frames, body, most)
    sway = WANDER_M * np.array([1.0, float(hand), 1.0])  # a body's height is the floor's matter
    moved = _track(lambda: sway * rng.standard_normal((1, 3)), settings.frames, STEP_M, 5 * STEP_M)
    rotation = first * Rotation.from_rotvec(turn[:, 0])
    return rotation.as_rotvec(), moved[:, 0]


def _grounded(model: BodyModel, drawn: PoseSequence) -> PoseSequence:
    """Put the lowest point of every frame on the floor."""
    lowest = drawn.vertices(model)[..., 1].min(axis=1)
    return replace(drawn, translation=drawn.translation - lowest[:, None] * [0.0, 1.0, 0.0])


def _checked(model: BodyModel, s: SequenceSettings) -> dict[str, NDArray[np.bool_]]:
    """Return which frames lack which hand."""
    if s.frames < 1 or min(s.body_deg, s.hand_deg, s.most_deg) <= 0:
        raise SamplingError(
            f"frames={s.frames}, body_deg={s.body_deg}, hand_deg={s.hand_deg}, "
            f"most_deg={s.most_deg}: all must be > 0"
        )
    sides = hands_of(model) if model.hand is None else (model.hand,)
    missing: dict[str, NDArray[np.bool_]] = {}
    missing |= {side: np.zeros(s.frames, dtype=np.bool_) for side in sides}
    for side, (first, stop) in s.missing.items():
        if side not in missing or not 0 <= first <= stop <= s.frames:
            raise SamplingError(
                f"missing={{{side!r}: ({first}, {stop})}}: expected one of {', '.join(sides)} and "
                f"frames 0 <= first <= stop <= {s.frames}"
            )
        missing[side][first:stop] = True
    return missing
