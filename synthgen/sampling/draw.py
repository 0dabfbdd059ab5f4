"""Draw a whole sample: config, seed, index and attempt in, a fully resolved spec out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from synthgen.config import Config
from synthgen.errors import SamplingError
from synthgen.geometry.cameras import Camera, project
from synthgen.geometry.rotations import axis_angle_from_matrix
from synthgen.models import ManoModel, load_hand, pose_surface
from synthgen.sampling import orientation, placement
from synthgen.sampling.appearance import sample_skin, switched
from synthgen.sampling.clothing import sample_wear
from synthgen.sampling.hand_pose import prior_of, sample_hand_pose
from synthgen.sampling.limits import limits_of
from synthgen.sampling.penetration import probe_of
from synthgen.sampling.shape import sample_shape
from synthgen.sampling.spec import RenderSettings, SampleSpec
from synthgen.sampling.stage import Stage
from synthgen.sampling.streams import Streams, stream
from synthgen.sampling.surroundings import surround
from synthgen.scene import HandSubject, Scene, Skin
from synthgen.scene.description import Hand, Vec3
from synthgen.scene.wear import dress

Array = NDArray[np.float64]

POSE_TRIES = 200
PLACEMENT_TRIES = 32
MIRROR = np.array([1.0, -1.0, -1.0])  # axis-angle of a mirrored rotation, papers' A.1-A.5


@dataclass(frozen=True)
class _Person:
    subject_id: int
    shape: Array
    skin: Skin
    tone: float


def draw_sample(config: Config, index: int, attempt: int = 0) -> SampleSpec:
    """Resolve one sample.

    Parameters
    ----------
    config : Config
    index : int
        Position in the corpus, >= 0.
    attempt : int
        0 in the plan; higher where the sample is redrawn after a rejection.

    Returns
    -------
    SampleSpec
        A pure function of the arguments (and of the model's file and library versions).

    Raises
    ------
    SamplingError
        If the configuration cannot be met; the message says which setting to change.
    """

    def streams(name: str) -> np.random.Generator:
        return stream(config.seed, "sample", index, attempt, name)

    hand = _side(config, streams("hand"))
    person = _person(config, index, streams("identity"))
    pose, source, depth = _pose(config, person.shape, index, streams("pose"))
    placed = _dressed(config, _place(config, person, hand, pose, index, streams), streams("wear"))
    around = surround(config, placed.stage(), streams)
    scene = Scene(
        (placed.subject,), around.cameras, around.lights, around.background, around.things,
        around.motion, around.optics, around.sensor,
    )  # fmt: skip
    factors: dict[str, float | int | str] = {
        "hand": hand,
        "subject_id": person.subject_id,
        "skin_tone": round(person.tone, 6),
        "pose_source": source,
        "penetration_m": round(depth, 6),
        **placed.factors,
        **around.factors,
        "sleeve": int(placed.subject.sleeve is not None),
        "bands": len(placed.subject.bands),
    }
    settings = _render_settings(config, streams("render"))
    if config.render.quality == "full":
        factors["denoise"] = settings.denoise
    return SampleSpec(index, attempt, scene, settings, factors)


def _side(config: Config, rng: np.random.Generator) -> Hand:
    drawn: Hand = "right" if rng.random() < 0.5 else "left"
    return drawn if config.model.hands == "both" else config.model.hands


def _person(config: Config, index: int, rng: np.random.Generator) -> _Person:
    count = config.subjects.count
    subject_id = index if count is None else int(rng.integers(count))
    n_betas = load_hand(config.model.name, hand="right").shapedirs.shape[2]
    shape = sample_shape(
        n_betas,
        sigma=config.shape.sigma,
        limit=config.shape.limit,
        rng=stream(config.seed, "subject", subject_id, 0, "shape"),
    )
    skin, tone = sample_skin(
        config.skin.tones, rng=stream(config.seed, "subject", subject_id, 0, "skin")
    )
    varnish = stream(config.seed, "subject", subject_id, 0, "varnish")
    return _Person(subject_id, shape, switched(skin, config.skin, rng=varnish), tone)


def _pose(
    config: Config, shape: Array, index: int, rng: np.random.Generator
) -> tuple[Array, str, float]:
    """Draw right-hand poses until one penetrates itself less than the limit.

    Poses of the same source: uniform ones penetrate more often, and would lose their share.
    """
    model = load_hand(config.model.name, hand="right")
    limits, probe = limits_of(model), probe_of(model)
    settings = config.pose
    prior, share = None, settings.gmm_share
    if share > 0:
        prior = prior_of(model, settings.gmm_components, settings.pca_components)
    for _ in range(POSE_TRIES):
        pose, source = sample_hand_pose(limits, prior, gmm_share=share, rng=rng)
        share = float(source == "gmm")
        depth = probe.depth_m(model.evaluate(shape[None], pose[None]).vertices[0])
        if depth <= settings.penetration_limit_m:
            return pose, source, depth
    raise SamplingError(
        f"sample {index}: {POSE_TRIES} poses in a row penetrate themselves by more than "
        f"pose.penetration_limit_m={settings.penetration_limit_m}; raise the limit"
    )


@dataclass(frozen=True)
class _Placed:
    subject: HandSubject
    cameras: tuple[Camera, ...]
    surface: Array
    factors: dict[str, float | int | str]

    def stage(self) -> Stage:
        """Return what other things must keep clear of: the subject with what it wears."""
        model = load_hand(self.subject.model, hand=self.subject.hand)
        worn = dress(model, self.subject)
        meshes = [mesh.vertices for mesh in (worn.sleeve, *worn.bands) if mesh is not None]
        around = np.concatenate([self.surface, *meshes])
        end = self.surface[model.surface.arm.end_ids]
        return Stage(around, model.surface.n_hand_vertices, self.cameras, end)


def _dressed(config: Config, placed: _Placed, rng: np.random.Generator) -> _Placed:
    sleeve, bands = sample_wear(config.wear, rng=rng)
    return replace(placed, subject=replace(placed.subject, sleeve=sleeve, bands=bands))


def _place(
    config: Config, person: _Person, hand: Hand, pose: Array, index: int, streams: Streams
) -> _Placed:
    """Turn the hand, put cameras around it and find an arm that leaves every picture.

    The hand keeps its turn to the camera while cameras and arms are tried, so that rejections do
    not colour the distribution of turns; only a turn that fails for long is drawn again.
    """
    model = load_hand(config.model.name, hand=hand)
    turn, look, arms = streams("orientation"), streams("camera"), streams("arm")
    seen_from = _orientation(config, hand, turn)
    centre = np.array([0.0, 1.25, 0.0]) + look.uniform(-0.2, 0.2, 3)
    found = None
    for number in range(PLACEMENT_TRIES):
        if number >= PLACEMENT_TRIES // 2:
            seen_from = _orientation(config, hand, turn)
        view = placement.sample_view(rng=look)
        rotation = axis_angle_from_matrix(view @ seen_from)
        still = _subject(config, person, hand, np.vstack([rotation, _sided(pose, hand)[1:]]))
        still = _centred(model, still, centre)
        cameras, factors = _cameras(config, model, still, view, look)
        found = _arm(model, still, cameras, arms)
        if found is not None:
            return _Placed(found[0], cameras, found[1], factors)
    placement.require_arm(found, index, PLACEMENT_TRIES * placement.ARM_TRIES)
    raise AssertionError("unreachable")  # pragma: no cover


def _orientation(config: Config, hand: Hand, rng: np.random.Generator) -> Array:
    if config.orientation.mode == "uniform":
        return orientation.uniform_rotation(rng=rng)
    seen = orientation.cone_rotation(config.orientation.cone_deg, rng=rng)
    return seen if hand == "right" else orientation.mirror_rotation(seen)


def _sided(pose: Array, hand: Hand) -> Array:
    return pose if hand == "right" else pose * MIRROR


def _subject(config: Config, person: _Person, hand: Hand, pose: Array) -> HandSubject:
    return HandSubject(
        subject_id=person.subject_id,
        model=config.model.name,
        hand=hand,
        shape=_short(person.shape),
        pose=tuple(_vec3(row) for row in pose),
        translation_m=(0.0, 0.0, 0.0),
        wrist=(0.0, 0.0, 0.0),
        elbow=(0.0, 0.0, 0.0),
        skin=person.skin,
    )


def _short(values: Array) -> tuple[float, ...]:
    return tuple(round(float(v), 9) for v in values)


def _vec3(values: Array) -> Vec3:
    a, b, c = _short(values)
    return a, b, c


def _centred(model: ManoModel, subject: HandSubject, centre: Array) -> HandSubject:
    points = _hand_points(model, subject)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return replace(subject, translation_m=_vec3(centre - middle))


def _hand_points(model: ManoModel, subject: HandSubject) -> Array:
    posed = model.evaluate(
        np.array([subject.shape]), np.array([subject.pose]), np.array([subject.translation_m])
    )
    return np.asarray(posed.vertices[0], dtype=np.float64)


def _cameras(
    config: Config,
    model: ManoModel,
    subject: HandSubject,
    first_view: Array,
    rng: np.random.Generator,
) -> tuple[tuple[Camera, ...], dict[str, float | int | str]]:
    points = _hand_points(model, subject)
    cameras: list[Camera] = []
    factors: dict[str, float | int | str] = {}
    for number in range(config.camera.views):
        view = first_view if number == 0 else placement.sample_view(rng=rng)
        lens = placement.sample_lens(
            config.render.width, config.render.height, config.camera.fov_deg, rng=rng
        )
        fill = float(rng.uniform(*config.camera.fill))
        offset = rng.uniform(-config.camera.offset, config.camera.offset, 2)
        transform, distance = placement.camera_position(points, lens, fill, offset, view)
        cameras.append(lens.camera(transform))
        if number == 0:  # a wide lens would have to come too near for some fills
            reached = np.ptp(project(cameras[0], points)[0], axis=0).max()
            fill = float(reached / min(lens.width, lens.height))
            factors = {"fov_deg": lens.fov_deg, "fill": fill, "distance_m": distance}
    return tuple(cameras), {k: round(float(v), 6) for k, v in factors.items()}


def _arm(
    model: ManoModel, subject: HandSubject, cameras: tuple[Camera, ...], rng: np.random.Generator
) -> tuple[HandSubject, Array] | None:
    n_hand, end = model.surface.n_hand_vertices, model.surface.arm.end_ids
    for _ in range(placement.ARM_TRIES):
        wrist, elbow = placement.sample_arm(rng=rng)
        tried = replace(subject, wrist=_vec3(np.array(wrist)), elbow=_vec3(np.array(elbow)))
        surface = surface_of(model, tried)
        if placement.arm_leaves_frame(surface[end], surface[n_hand:], cameras):
            return tried, surface
    return None


def surface_of(model: ManoModel, subject: HandSubject) -> Array:
    """Return a subject's surface vertices (S, 3), hand then arm, world, metres."""
    surface, _ = pose_surface(
        model,
        np.array(subject.shape),
        np.array(subject.pose),
        np.array(subject.translation_m),
        np.array(subject.wrist),
        np.array(subject.elbow),
    )
    return np.asarray(surface, dtype=np.float64)


def _render_settings(config: Config, rng: np.random.Generator) -> RenderSettings:
    return RenderSettings(
        quality=config.render.quality,
        spp=config.render.spp,
        max_depth=config.render.max_depth,
        seed=int(rng.integers(2**31)),
        denoise=_denoiser(config.render.denoise),
        diffusion=config.render.diffusion,
    )


def _denoiser(wanted: str) -> str:
    """Resolve ``auto``: the denoiser where it is installed, and an entry in the plan either way."""
    if wanted != "auto":
        return wanted
    return "oidn" if find_spec("mitsuba_oidn") is not None else "none"
