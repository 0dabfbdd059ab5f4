"""Baked maps: no seams, kept in the cache, whole or not at all."""

from __future__ import annotations

import dataclasses
import inspect
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from synthgen.models import ManoModel, load
from synthgen.render.skin import bake as module
from synthgen.render.skin.albedo import albedo
from synthgen.render.skin.bake import SkinMaps, bake, bake_maps
from synthgen.sampling.appearance import sample_skin
from synthgen.sampling.streams import stream
from synthgen.scene.surface import DrawnSurface

SIZE = 512


@pytest.fixture(scope="module")
def hand() -> ManoModel:
    return load("cc0-hand")


@pytest.fixture(scope="module")
def maps(hand: ManoModel) -> SkinMaps:
    return bake_maps(hand, SIZE)


def same(a: SkinMaps, b: SkinMaps) -> bool:
    names = [f.name for f in dataclasses.fields(SkinMaps)]
    return all(np.array_equal(getattr(a, n), getattr(b, n)) for n in names)


def test_smoke_shapes_and_ranges(maps: SkinMaps) -> None:
    n = int(maps.fill.max()) + 1
    for name in ("palm", "inner", "knuckle", "tip", "pad", "vein", "plate", "cuticle", "tint"):
        values = getattr(maps, name)
        assert values.shape == (n,)
        assert -1e-3 <= values.min() <= values.max() <= 1.05, name
        assert values.max() > 0.4, name
    assert maps.size == SIZE
    assert np.isfinite(maps.still).all()


def _borders(hand: ManoModel) -> tuple[np.ndarray, np.ndarray]:
    """Texture coordinates (m, 2) of the middles of all border edges, on either side."""
    drawn = DrawnSurface.for_model(hand)
    corner = drawn.triangles.astype(np.int64)
    half = np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]])
    seam: dict[tuple[int, int], np.ndarray] = {}
    sides: list[tuple[np.ndarray, np.ndarray]] = []
    for a, b in half:
        key = (int(drawn.source[a]), int(drawn.source[b]))
        middle = (drawn.uv[a] + drawn.uv[b]) / 2
        other = seam.pop((key[1], key[0]), None)
        if other is None:
            seam[key] = middle
        elif np.abs(other - middle).max() > 1e-4:
            sides.append((other, middle))
    left, right = zip(*sides, strict=True)
    return np.array(left), np.array(right)


def test_properties_no_seam_at_any_border(hand: ManoModel, maps: SkinMaps) -> None:
    """Both sides of every border of the atlas show the same skin, to a texel's difference."""
    first, second = _borders(hand)
    assert len(first) > 200
    skin, _ = sample_skin((0.9, 0.9), rng=stream(0, "subject", 0, 0, "skin"))
    picture = albedo(maps, skin).astype(np.float64)
    heights = (maps.still + maps.wrinkles + maps.folds + maps.lines)[maps.fill][..., None]

    def at(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
        column = np.clip((uv[:, 0] * SIZE).astype(int), 0, SIZE - 1)
        row = np.clip(((1 - uv[:, 1]) * SIZE).astype(int), 0, SIZE - 1)
        return image[row, column]

    for image in (picture / picture.mean(), heights / heights.std()):
        across = np.abs(at(image, first) - at(image, second)).max(axis=1)
        beside = np.abs(at(image, first + 1.5 / SIZE) - at(image, first)).max(axis=1)
        usual = np.abs(np.diff(image, n=1, axis=0)[::2]).max(axis=-1)
        usual = usual[usual > 0]
        assert np.median(across) < 1.5 * max(np.median(beside), np.median(usual))
        assert np.quantile(across, 0.98) < 2.5 * np.quantile(usual, 0.98)


def test_properties_left_and_right_share_their_maps(hand: ManoModel) -> None:
    left = load("cc0-hand", hand="left")
    assert same(bake(left, 128), bake(hand, 128))
    assert bake(left, 128) is bake(left, 128)


def test_properties_read_back_is_what_was_baked(
    hand: ManoModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SYNTHGEN_CACHE", str(tmp_path))
    module._cached.cache_clear()
    first = bake(hand, 128)
    (file,) = (tmp_path / "skin").iterdir()
    assert file.suffix == ".npz"
    module._cached.cache_clear()
    monkeypatch.setattr(module, "bake_maps", lambda *_: pytest.fail("baked again"))
    assert same(bake(hand, 128), first)


@pytest.mark.parametrize(
    "changed", ["synthgen.render.skin.bake", "synthgen.geometry.raster", "numpy"]
)
def test_properties_whatever_decides_a_bake_makes_new_maps(
    hand: ManoModel, monkeypatch: pytest.MonkeyPatch, changed: str
) -> None:
    """Old maps under new code or libraries would be other bytes than another machine makes."""
    before = module._key(hand, 128)
    source, version = inspect.getsource, metadata.version
    monkeypatch.setattr(inspect, "getsource", lambda m: source(m) + "#" * (m.__name__ == changed))
    monkeypatch.setattr(metadata, "version", lambda name: version(name) + "0" * (name == changed))
    assert module._key(hand, 128) != before


def test_edge_a_broken_cache_file_is_replaced(
    hand: ManoModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SYNTHGEN_CACHE", str(tmp_path))
    module._cached.cache_clear()
    first = bake(hand, 128)
    (file,) = (tmp_path / "skin").iterdir()
    whole = file.read_bytes()
    for broken in (b"", b"not an archive", whole[: len(whole) // 2]):
        file.write_bytes(broken)
        module._cached.cache_clear()
        assert same(bake(hand, 128), first)
        assert len(file.read_bytes()) == len(whole)


def test_edge_a_cache_that_cannot_be_written_costs_only_time(
    hand: ManoModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    monkeypatch.setenv("SYNTHGEN_CACHE", str(blocked))
    module._cached.cache_clear()
    assert bake(hand, 128).size == 128
    module._cached.cache_clear()
