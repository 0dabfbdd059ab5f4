"""Posed cc0 bodies and their simulated scans, for the tests of registration."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from synthgen import models
from synthgen.models import BodyModel
from synthgen.models.joints import SIDES
from synthgen.registration.body_fit import body_scan, body_surface
from synthgen.registration.body_schedule import hand_vertices
from synthgen.registration.body_surface import BodySurface
from synthgen.registration.scan import Scan
from synthgen.registration.simulated_body import BodyScanSettings, simulate_body_scan
from synthgen.sampling.body_pose import sample_body_pose, upright
from synthgen.sampling.streams import stream

NAMES = ("cc0-body", "cc0-supr")


def model(name: str = "cc0-body") -> BodyModel:
    return models.load(name)


def surface(name: str = "cc0-body") -> BodySurface:
    return body_surface(model(name))


def rng(name: str) -> np.random.Generator:
    return stream(0, "sample", 0, 0, name)


@lru_cache(maxsize=8)
def truth(number: int = 0, name: str = "cc0-body") -> np.ndarray:
    """A person who was asked to stand in an A-pose, turned any way."""
    random, s = stream(number, "sample", 0, 0, "body test"), surface(name)
    shape = np.clip(random.standard_normal(s.model.n_shape), -2, 2)
    pose = sample_body_pose(s.model, 0.35, rng=random, shape=shape)
    pose[0] = upright(rng=random)
    x = s.pack(shape, pose, np.array([0.1, 0.9, -0.2]))
    if s.model.n_expression:
        x[s.expression] = np.clip(random.standard_normal(s.model.n_expression), -2, 2)
    return x


@lru_cache(maxsize=8)
def scanned(
    number: int = 0, name: str = "cc0-body", lost: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals; the share ``lost`` of the left hand is missing."""
    random = stream(number, "sample", 1, 0, "body test")
    vertices = surface(name).at(truth(number, name)).vertices
    settings = BodyScanSettings(points=60_000, lost={"left": lost} if lost else {})
    found = simulate_body_scan(model(name), vertices, settings, rng=random)
    return found.points, found.normals


@lru_cache(maxsize=4)
def scan(number: int = 0) -> Scan:
    return body_scan(*scanned(number))


def errors_mm(vertices: np.ndarray, number: int = 0, name: str = "cc0-body") -> dict[str, float]:
    """Mean error of the body without hands, and of each hand."""
    s = surface(name)
    off = 1e3 * np.linalg.norm(vertices - s.at(truth(number, name)).vertices, axis=1)
    hands = {side: hand_vertices(s, side) for side in SIDES}
    rest = np.ones(s.n_vertices, dtype=bool)
    rest[np.concatenate(list(hands.values()))] = False
    return {"body": float(off[rest].mean()), **{k: float(off[v].mean()) for k, v in hands.items()}}
