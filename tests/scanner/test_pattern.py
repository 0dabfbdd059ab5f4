"""Slides: fill, size of blobs, statistics of laser speckle, the pyramid, the packing."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from synthgen.errors import ConfigError
from synthgen.scanner.pattern import packed, pyramid, slide
from synthgen.scanner.rig import Pattern, PatternKind

N = 384


def make(kind: PatternKind = "speckle", **changes: object) -> np.ndarray:
    values: dict[str, object] = {"dot_px": 5.0, "fill": 0.5, "seed": 3, **changes}
    return slide(Pattern(kind, **values), N)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ["speckle", "dots", "laser"])
def test_smoke_range_and_seed(kind: PatternKind) -> None:
    image = make(kind, fill=0.3)
    assert image.shape == (N, N)
    assert image.dtype == np.float32
    assert image.min() >= 0
    assert image.max() <= 1
    assert np.array_equal(image, make(kind, fill=0.3))
    assert not np.array_equal(image, make(kind, fill=0.3, seed=4))


@pytest.mark.parametrize("kind", ["speckle", "dots"])
@pytest.mark.parametrize("fill", [0.15, 0.3, 0.5])
def test_properties_fill(kind: PatternKind, fill: float) -> None:
    assert (make(kind, fill=fill) > 0.5).mean() == pytest.approx(fill, abs=0.03)


def test_properties_blobs_grow_with_the_dot() -> None:
    """The autocorrelation of blurred noise is sqrt(2) wider than the blur."""
    for dot in (4.0, 8.0):
        image = make(dot_px=dot) - 0.5
        power = np.abs(np.fft.fft2(image)) ** 2
        along = np.fft.ifft2(power).real[0, :40]
        half = np.interp(-0.5, -along / along[0], np.arange(40))
        assert 2 * half == pytest.approx(1.25 * dot, rel=0.15)


def test_reference_laser_speckle_has_negative_exponential_intensity() -> None:
    image = make("laser")
    mean = image.mean()
    assert image.std() / mean == pytest.approx(1, rel=0.06)
    for multiple in (0.5, 1, 2):
        assert (image > multiple * mean).mean() == pytest.approx(np.exp(-multiple), abs=0.03)


def test_properties_dots_do_not_touch_and_do_not_repeat_along_rows() -> None:
    image = make("dots", fill=0.15)
    count, _, stats, _ = cv2.connectedComponentsWithStats((image > 0.5).astype(np.uint8))
    inner = stats[1:][stats[1:, cv2.CC_STAT_WIDTH] < 12]
    assert count > 500
    assert np.median(inner[:, cv2.CC_STAT_AREA]) == pytest.approx(np.pi * 2.5**2, rel=0.3)
    power = np.abs(np.fft.fft2(image - image.mean())) ** 2
    along = np.fft.ifft2(power).real[0]
    assert np.abs(along[8:190]).max() < 0.25 * along[0]


def test_reference_pyramid_is_the_blurred_slide() -> None:
    image = slide(Pattern("speckle", 5.0, 0.5, 3), N + 5)  # no multiple of the blocks
    for k, level in enumerate(pyramid(image)[1:4], start=1):
        sigma = 2.0**k
        wanted = cv2.GaussianBlur(image, (0, 0), sigma)
        y, x = np.mgrid[64:350:3, 64:350:3]
        at = (x + 0.5) / sigma - 0.5, (y + 0.5) / sigma - 0.5
        got = cv2.remap(
            level.astype(np.float32) / 255, *(a.astype(np.float32) for a in at), cv2.INTER_LINEAR
        )
        error = got - wanted[64:350:3, 64:350:3]
        assert np.sqrt((error**2).mean()) < 0.12 * wanted.std()


def test_reference_packing_holds_the_neighbours() -> None:
    level = pyramid(make())[2]
    words = packed(level).reshape(level.shape)
    assert np.array_equal(words & 0xFF, level)
    assert np.array_equal((words >> 8 & 0xFF)[:, :-1], level[:, 1:])
    assert np.array_equal((words >> 16 & 0xFF)[:-1], level[1:])
    assert np.array_equal((words >> 24 & 0xFF)[:-1, :-1], level[1:, 1:])


def test_smoke_picture_of_the_user(tmp_path: Path) -> None:
    drawn = np.zeros((50, 80), np.uint8)
    drawn[:, 40:] = 255
    path = tmp_path / "slide.png"
    cv2.imwrite(str(path), drawn)
    image = make("image", image=str(path))
    assert image.shape == (N, N)
    assert image[:, : N // 3].max() == 0
    assert image[:, -N // 3 :].min() == 1


def test_edge_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        make("image", image=str(tmp_path / "none.png"))
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(ConfigError, match="no picture that OpenCV reads"):
        make("image", image=str(tmp_path / "text.png"))
    with pytest.raises(ConfigError, match="without touching"):
        make("dots", fill=0.8)
