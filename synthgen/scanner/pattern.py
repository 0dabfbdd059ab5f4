"""Slides of speckle projectors, and their pyramids of blurred copies for defocus."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ConfigError
from synthgen.sampling.streams import stream
from synthgen.scanner.rig import Pattern

Image = NDArray[np.float32]

# Full width at half maximum of a Gaussian over its sigma.
_FWHM = 2.3548
# Steepness of the soft threshold of speckle: edges about a third of a blob wide, as through a lens.
_STEEP = 6.0
# Laser speckle has no brightest value; the slide is 1 at this multiple of the mean.
_LASER_WHITE = 6.0
LEVELS = 5


def slide(pattern: Pattern, size_px: int) -> Image:
    """Make a slide.

    Parameters
    ----------
    pattern : Pattern
    size_px : int
        Edge, texels.

    Returns
    -------
    (n, n) float32
        0..1. Speckle is white noise blurred to ``dot_px`` (full width at half maximum of the blur),
        softly cut so that ``fill`` of it is bright.

    Raises
    ------
    ConfigError
        If the user's picture is missing or unreadable.
    """
    if pattern.kind == "image":
        return _picture(pattern.image, size_px)
    rng = stream(pattern.seed, "scanner", 0, 0, pattern.kind)
    if pattern.kind == "dots":
        return _dots(pattern, size_px, rng)
    noise = _band_limited(size_px, pattern.dot_px, rng)
    if pattern.kind == "laser":
        other = _band_limited(size_px, pattern.dot_px, rng)
        intensity = (noise * noise + other * other) / 2
        return np.asarray(np.minimum(intensity / _LASER_WHITE, 1), dtype=np.float32)
    cut = np.quantile(noise[::8, ::8], 1 - pattern.fill)
    return np.asarray(1 / (1 + np.exp(-_STEEP * (noise - np.float32(cut)))), dtype=np.float32)


def _band_limited(n: int, dot_px: float, rng: np.random.Generator) -> Image:
    noise = rng.standard_normal((n, n), dtype=np.float32)
    blurred = cv2.GaussianBlur(noise, (0, 0), dot_px / _FWHM, borderType=cv2.BORDER_REFLECT)
    return np.asarray(blurred / blurred.std(), dtype=np.float32)


def _dots(pattern: Pattern, n: int, rng: np.random.Generator) -> Image:
    """Soft round dots that never touch, in rows whose gaps are exponential: nothing repeats."""
    radius = pattern.dot_px / 2
    area = np.pi * radius * radius
    pitch = 2 * radius + 1
    gap = area / (pattern.fill * pitch) - pitch
    if gap < 0:
        raise ConfigError(
            f"dots cannot fill {pattern.fill:g} of a slide without touching; at most "
            f"{area / pitch**2:.2f}: lower `fill`, or use kind: speckle"
        )
    rows, most = int(np.ceil(n / pitch)), int(1.5 * n / (pitch + gap)) + 20
    steps = pitch + gap * rng.standard_exponential((rows, most))
    x = np.cumsum(steps, axis=1) - steps[:, :1] * rng.random((rows, 1))
    y = np.arange(rows)[:, None] * pitch + radius + 0.8 * rng.random(x.shape)
    x, y = x[x < n + pitch], y[x < n + pitch]
    image = np.zeros((n, n), dtype=np.float32)
    column, row = np.rint(x).astype(np.int64), np.rint(y).astype(np.int64)
    reach = int(np.ceil(radius + 1))
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            i, j = row + down, column + right
            value = np.clip(radius + 0.5 - np.hypot(j - x, i - y), 0, 1)
            use = (value > 0) & (i >= 0) & (i < n) & (j >= 0) & (j < n)
            at = i[use], j[use]
            image[at] = np.maximum(image[at], value[use].astype(np.float32))
    return image


def picture_bytes(path: str) -> bytes:
    """Read a user's slide; raises ConfigError where it cannot be read."""
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise ConfigError(f"slide {path}: cannot be read ({error.strerror})") from None


def _picture(path: str, n: int) -> Image:
    data = np.frombuffer(picture_bytes(path), dtype=np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None
    if image is None:
        raise ConfigError(f"slide {path} is no picture that OpenCV reads; use PNG or JPEG")
    shrink = image.shape[0] > n or image.shape[1] > n
    kernel = cv2.INTER_AREA if shrink else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, (n, n), interpolation=kernel) / 255, dtype=np.float32)


def pyramid(image: Image) -> list[NDArray[np.uint8]]:
    """Return the slide blurred with sigma 0, 2, 4, 8 and 16 texels, each level half as large.

    8 bits, as projectors have. A level of scale s is read by bilinear interpolation, which together
    with the averaging over s texels blurs by s^2 / 4 (variance); the rest is blurred beforehand.
    """
    levels = [image]
    # Whole blocks at every level, so that all levels keep their place on the slide.
    room = -len(image) % 2 ** (LEVELS - 1)
    image = np.pad(image, ((0, room), (0, room)), mode="edge")
    for k in range(1, LEVELS):
        scale = 2.0**k
        blurred = cv2.GaussianBlur(
            image, (0, 0), scale * np.sqrt(0.75), borderType=cv2.BORDER_REPLICATE
        )
        n = len(image) >> k
        small = cv2.resize(blurred, (n, n), interpolation=cv2.INTER_AREA)
        levels.append(np.asarray(small, dtype=np.float32))
    return [np.asarray(np.rint(255 * np.clip(level, 0, 1)), dtype=np.uint8) for level in levels]


def packed(level: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Pack every texel with its right, lower and diagonal neighbour, so that one read interpolates.

    Parameters
    ----------
    level : (n, n) uint8

    Returns
    -------
    (n * n,) uint32
        Bytes from the lowest: own, right, below, diagonal; edges repeat.
    """
    wide = np.pad(level, ((0, 1), (0, 1)), mode="edge").astype(np.uint32)
    both = wide[:-1, :-1] | wide[:-1, 1:] << 8 | wide[1:, :-1] << 16 | wide[1:, 1:] << 24
    return np.asarray(both.ravel(), dtype=np.uint32)


def packed_pyramid(pattern: Pattern, size_px: int) -> tuple[NDArray[np.uint32], ...]:
    """Return the packed levels of a slide."""
    return tuple(packed(level) for level in pyramid(slide(pattern, size_px)))
