"""Scanning the hand of every sample of a corpus."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np

from synthgen.config import Config
from synthgen.corpus.columns import Members, ScannedView
from synthgen.corpus.scans import scan_members, stereo_members
from synthgen.errors import CorpusError, ScanError
from synthgen.geometry.normals import unit
from synthgen.render.renderer import RenderedView
from synthgen.sampling.spec import SampleSpec
from synthgen.sampling.streams import stream
from synthgen.scanner import Effects, Scan, ScanScene, load_rig, scan, settings_for
from synthgen.scanner.hand import HandSolid, hand_solid, moved_subject, rig_from_world
from synthgen.scanner.sensor import SENSOR_EFFECTS, without
from synthgen.scanner.subject import moved
from synthgen.scene.description import Vec3

LARGEST_LEAN_RAD = 0.25
Attempt = Callable[[SampleSpec], tuple[str | None, list[RenderedView]]]


class Scanning:
    """Adds a scan to what another maker makes; rejects samples whose scan is empty."""

    def __init__(self, config: Config, inner: Attempt) -> None:
        assert config.scanner.rig is not None
        self._config, self._inner = config, inner
        asked, off = config.scanner, set(config.scanner.without)
        rig = load_rig(config.scanner.rig, asked.seed)
        self._rig = without(rig, off & set(SENSOR_EFFECTS))
        self._settings = replace(
            settings_for(self._rig, asked.level, asked.preset),
            true_disparity="stereo" in config.corpus.columns,
        )
        self._effects = Effects(**dict.fromkeys(off - set(SENSOR_EFFECTS), False))

    def attempt(self, spec: SampleSpec) -> tuple[str | None, list[RenderedView]]:
        """Make views and scan of a sample, or say why it must be drawn again."""
        reason, views = self._inner(spec)
        if reason is not None:
            return reason, views
        try:
            found, T_world_from_rig = self.scan(spec)
        except ScanError as error:
            return f"scan: {error}", []
        if found.problem is not None:
            return f"scan: {found.problem}", []
        members: dict[str, Members] = {
            "scan": scan_members(found, self._rig, T_world_from_rig),
        }
        if "stereo" in self._config.corpus.columns:
            members["stereo"] = stereo_members(found)
        own = {f.name: getattr(views[0], f.name) for f in fields(RenderedView)}
        return None, [ScannedView(**own, members=members), *views[1:]]

    def scan(self, spec: SampleSpec) -> tuple[Scan, np.ndarray]:
        """Return the scan of a sample's hand in the sample's world, and ``T_world_from_rig``.

        The hand is turned into the scanner: fingers up, any side forwards, leaning a little.
        """
        if len(spec.scene.subjects) != 1:
            raise CorpusError(
                f"sample {spec.index} has {len(spec.scene.subjects)} hands; a scanner takes one"
            )
        subject = spec.scene.subjects[0]
        where = stream(self._config.seed, "sample", spec.index, spec.attempt, "scan placement")
        spin = float(where.uniform(0, 2 * np.pi))
        lean = float(where.uniform(-LARGEST_LEAN_RAD, LARGEST_LEAN_RAD))
        R, shift = rig_from_world(subject, spin, lean)
        hand = hand_solid(moved_subject(subject, R, shift))
        rng = stream(self._config.seed, "sample", spec.index, spec.attempt, "scan")
        found = scan(
            moved(ScanScene((hand.solid,)), self._velocity(spec)), self._rig, rng=rng,
            level=self._config.scanner.level, settings=self._settings, effects=self._effects,
        )  # fmt: skip
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R.T, -R.T @ shift
        return (found if found.problem else _on_model(found.moved(T), hand)), T

    def _velocity(self, spec: SampleSpec) -> Vec3:
        """Return the asked speed, any way, in the rig's frame."""
        rng = stream(self._config.seed, "sample", spec.index, spec.attempt, "scan motion")
        x, y, z = (self._config.scanner.speed_m_s * unit(rng.standard_normal(3))).tolist()
        return x, y, z


def _on_model(found: Scan, hand: HandSolid) -> Scan:
    """Let the provenance refer to the model's own faces instead of the drawn ones."""
    face, inside = hand.on_model(found.provenance["face"], found.provenance["barycentric"])
    return replace(found, provenance=found.provenance | {"face": face, "barycentric": inside})
