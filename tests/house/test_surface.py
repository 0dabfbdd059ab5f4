"""The public surface: what users may rely on. A change here is a change of the promise."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import typer.main

import synthgen
import synthgen.config
import synthgen.models
import synthgen.registration
import synthgen.scanner
from synthgen.cli.main import app
from synthgen.config import Config
from synthgen.config.explain import dotted_keys

TOP = [
    "__version__", "config", "corpus", "geometry", "models", "open_corpus", "registration",
    "sampling", "scanner", "scene", "verify",
]  # fmt: skip
MODELS = {
    "Attachment", "BodyModel", "FootNetwork", "Forward", "Gradient", "HandSpace", "Jacobian",
    "ManoModel", "Posed", "as_torch", "attachments_of", "deform_feet", "dressed", "feet_of",
    "forward", "list_models", "load", "pose_from_pca", "recentre", "touching",
}  # fmt: skip
SCANNER = {
    "CropPlane", "Effects", "Rig", "Scan", "ScanScene", "ScanSettings", "Solid", "Surface",
    "UnitScan", "body_scene", "centred", "is_green", "list_rigs", "load_rig", "save_scan", "scaled",
    "scan", "segment", "sense_depth", "settings_for", "solid_from_mesh", "standing",
}  # fmt: skip
REGISTRATION = [
    "REASONS", "Aligned", "Fit", "Track", "fit", "fit_many", "subject_template", "track"
]  # fmt: skip
CONFIG = {"Config", "config_hash", "load_config", "resolved_yaml"}
KEYS = [
    "seed", "samples", "model.name", "model.hands", "subjects.count", "shape.sigma", "shape.limit",
    "pose.gmm_share", "pose.gmm_components", "pose.pca_components", "pose.penetration_limit_m",
    "orientation.mode", "orientation.cone_deg", "camera.views", "camera.fov_deg", "camera.fill",
    "camera.offset", "light.constant", "light.area", "light.room", "light.lamp", "light.sky",
    "light.hdri", "background.plain", "background.procedural", "background.room",
    "background.empty", "background.outdoor", "background.photo", "things.furniture",
    "things.support", "things.occluder", "wear.sleeve", "wear.ring", "wear.bracelet", "wear.watch",
    "skin.tones", "skin.detail", "skin.relief_m", "skin.creases", "skin.veins", "skin.mottle",
    "skin.freckles", "skin.sweat", "skin.varnish", "optics.distortion", "optics.defocus",
    "optics.motion", "optics.motion_px", "sensor.exposure_ev", "sensor.white_balance",
    "sensor.balance_error", "sensor.psf_px", "sensor.full_well", "sensor.read_e", "sensor.bayer",
    "sensor.sharpen", "sensor.bloom", "sensor.jpeg", "files.hdri", "files.images",
    "files.licence", "render.width", "render.height", "render.spp", "render.quality",
    "render.max_depth", "render.denoise", "render.diffusion", "render.sensor_depth",
    "render.variant",
    "scanner.rig", "scanner.level", "scanner.seed", "scanner.preset", "scanner.without",
    "scanner.speed_m_s", "corpus.shard_size",
    "corpus.columns", "corpus.jpeg_quality",
]  # fmt: skip
_CONFIG = ["CONFIG"]
VERBS = {
    "doctor": ["rig", "NAME", "--seed", "--out", "--json"],
    "models list": ["--json"],
    "models show": [
        "NAME", "--hand", "--mano", "--official-left-shape", "--picture", "--json",
    ],
    "models convert": ["SRC", "DST", "--mano", "--hand", "--part", "--json"],
    "models build": ["NAME", "--source", "--out", "--json"],
    "config schema": ["--json"],
    "config show": ["CONFIG", "--set", "--json"],
    "plan": ["CONFIG", "--out", "--samples", "--seed", "--set", "--json"],
    "generate": [
        "CONFIG", "--out", "--samples", "--seed", "--workers", "--shards", "--set", "--json",
    ],
    "show": ["DIR", "--sample", "--remake", "--out", "--json"],
    "verify": ["DIR", "--samples", "--start", "--report", "--self-test", "--json"],
    "fit": [
        "SCAN...", "--out", "--model", "--hand", "--start", "--coupled", "--preset", "--units",
        "--smooth", "--sequence", "--template", "--again", "--json",
    ],
    "train-init": ["MODEL", "--out", "--seconds", "--hands", "--json"],
    "preview": ["DIR", "--out", "--sheet", "--json"],
    "bench": ["NAME", "--rows", "--report", "--json"],
}  # fmt: skip


def verbs(command: Any, name: str = "") -> Iterator[tuple[str, list[str]]]:
    inner = getattr(command, "commands", None)
    if inner is None:
        yield name, [p.metavar if p.param_type_name == "argument" else p.opts[0]
                     for p in command.params]  # fmt: skip
        return
    for word, child in inner.items():
        yield from verbs(child, f"{name} {word}".strip())


def test_reference_top() -> None:
    assert synthgen.__all__ == TOP
    assert set(TOP) <= set(dir(synthgen))


@pytest.mark.parametrize("name", TOP)
def test_smoke_every_name_is_there(name: str) -> None:
    assert getattr(synthgen, name) is not None


def test_reference_rooms() -> None:
    assert set(synthgen.models.__all__) >= MODELS
    assert synthgen.registration.__all__ == REGISTRATION
    assert set(synthgen.config.__all__) >= CONFIG
    assert set(synthgen.scanner.__all__) >= SCANNER
    for room in (synthgen.models, synthgen.config, synthgen.scanner):
        for name in room.__all__:
            assert getattr(room, name) is not None


def test_reference_verbs() -> None:
    assert dict(verbs(typer.main.get_command(app))) == VERBS


def test_reference_config_keys() -> None:
    assert dotted_keys(Config.model_json_schema()) == KEYS


def test_edge_unknown_name() -> None:
    with pytest.raises(AttributeError, match="it has"):
        synthgen.no_such_thing  # noqa: B018
