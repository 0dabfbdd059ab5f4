"""Posed cc0 hands and their simulated scans, for the tests of registration."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from synthgen import models
from synthgen.cc0.poses import protocol_poses
from synthgen.models import ManoModel
from synthgen.registration.scan import Scan, scan_of
from synthgen.registration.simulated import ScanSettings, simulate_scan
from synthgen.registration.surface import Surface, surface_of
from synthgen.sampling.limits import limits_of
from synthgen.sampling.streams import stream


def model() -> ManoModel:
    loaded = models.load("cc0-hand")
    assert isinstance(loaded, ManoModel)
    return loaded


def surface() -> Surface:
    return surface_of(model())


def rng(name: str) -> np.random.Generator:
    return stream(0, "sample", 0, 0, name)


@lru_cache(maxsize=16)
def truth(number: int = 7) -> np.ndarray:
    """A protocol pose (7: tripod) with 3 degrees of noise, any rotation."""
    random = stream(number, "sample", 0, 0, "registration test")
    names, poses = protocol_poses(limits_of(model()))
    pose = poses[number % len(names)].copy()
    pose[1:] += random.normal(0, np.deg2rad(3), (15, 3))
    pose[0] = Rotation.random(rng=random).as_rotvec()
    shape = np.clip(random.standard_normal(10), -2, 2)
    return surface().pack(shape, pose, random.normal(0, 0.03, 3))


@lru_cache(maxsize=16)
def scanned(number: int = 7, noise_m: float = 2e-4) -> tuple[np.ndarray, np.ndarray]:
    vertices = surface().at(truth(number)).vertices
    settings = ScanSettings(points=20_000, noise_m=noise_m, pixels=200)
    random = stream(number, "sample", 1, 0, "registration test")
    points, normals, _ = simulate_scan(vertices, surface().faces, settings, rng=random)
    return points, normals


@lru_cache(maxsize=4)
def scan(number: int = 7) -> Scan:
    return scan_of(*scanned(number))


def perturbed(number: int = 7, degrees: float = 12.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean shape and pose, a rotation some degrees off."""
    _, pose, translation = surface().unpack(truth(number))
    start = np.zeros((16, 3))
    mean = model().hands_mean
    assert mean is not None
    start[1:] = mean.reshape(15, 3)
    turn = Rotation.from_rotvec(np.deg2rad(degrees) * np.array([0.6, -0.48, 0.64]))
    start[0] = (turn * Rotation.from_rotvec(pose[0])).as_rotvec()
    return np.zeros(10), start, translation


def error_mm(vertices: np.ndarray, number: int = 7) -> float:
    return 1e3 * float(
        np.linalg.norm(vertices - surface().at(truth(number)).vertices, axis=1).mean()
    )
