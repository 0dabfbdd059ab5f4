"""Procedural textures: walls, floors, tables, cloth, and an atlas for small things."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft, special

from synthgen.sampling.streams import stream
from synthgen.sampling.things import MOST_BOXES, MOST_TURNED
from synthgen.scene import Background, Band, Sleeve, Thing
from synthgen.scene.files import read_image

Array = NDArray[np.float64]
Image = NDArray[np.float32]

TEXTURE_PX = 512


def wall_texture(background: Background) -> Image:
    """Tileable reflectance (512, 512, 3) float32, linear, from the background's seed."""
    rng = stream(background.seed, "sample", 0, 0, "wall texture")
    pattern = 0.15 * _cloud(rng, 24)
    if background.kind == "room":  # mostly paint; else a paper of little contrast
        pattern = 0.4 * pattern + (0.35 * _pattern(rng) if rng.random() < 0.3 else 0)
    elif background.kind != "plain":
        pattern = pattern + 0.6 * _pattern(rng)
    share = np.clip(pattern, 0, 1)[..., None]
    first, second = (
        np.array(c, np.float32) for c in (background.colour_rgb, background.accent_rgb)
    )
    grain = 1 + 0.05 * _cloud(rng, 2)[..., None]
    return np.asarray(np.clip((first + share * (second - first)) * grain, 0.01, 0.95))


def _pattern(rng: np.random.Generator) -> Image:
    """Stripes, checks, tiles with joints, blotches or grain."""
    kind = ("stripes", "checks", "tiles", "blotches", "grain")[rng.integers(5)]
    steps = np.arange(TEXTURE_PX, dtype=np.float32) / TEXTURE_PX
    y, x = steps[:, None], steps[None]
    n = int(rng.integers(2, 9))
    if kind == "stripes":
        share = np.float32(rng.uniform(0.2, 0.6))
        return 0.9 * ((x * n + 0.02 * _cloud(rng, 32)) % 1 < share).astype(np.float32)
    if kind == "checks":
        return np.asarray(0.9 * ((np.floor(x * 2 * n) + np.floor(y * 2 * n)) % 2), np.float32)
    if kind == "tiles":
        joint = ((x * n) % 1 < 0.04) | ((y * n) % 1 < 0.04)
        return np.where(joint, np.float32(1), 0.12 * _cloud(rng, 48))
    if kind == "blotches":
        return np.asarray(special.expit(4 * _cloud(rng, int(rng.integers(8, 60)))))
    streaks = rng.standard_normal((256, 8)).astype(np.float32)
    wide = np.asarray(cv2.resize(streaks, (TEXTURE_PX,) * 2), np.float32)
    return 0.4 + 0.3 * wide + 0.1 * _cloud(rng, 4)


def _cloud(rng: np.random.Generator, size_px: int) -> Image:
    """Tileable band-limited noise (512, 512) with unit standard deviation.

    White noise under a Gaussian of ``2 size_px``, drawn as the few Fourier coefficients that pass.
    """
    width = TEXTURE_PX / (2 * size_px)
    top = min(TEXTURE_PX // 2 - 1, math.ceil(3.5 * width))
    fy, fx = np.arange(-top, top + 1), np.arange(top + 1)
    drawn = rng.standard_normal((2 * top + 1, top + 1, 2), dtype=np.float32) @ [1, 1j]
    drawn *= np.exp(-0.5 * (fx[None] ** 2 + fy[:, None] ** 2) / width**2)
    drawn[top, 0] = 0  # no mean
    spectrum = np.zeros((TEXTURE_PX, TEXTURE_PX // 2 + 1), dtype=np.complex64)
    spectrum[fy, : top + 1] = drawn
    noise = fft.irfft2(spectrum, s=(TEXTURE_PX, TEXTURE_PX))
    return np.asarray(noise / noise.std(), dtype=np.float32)


def floor_texture(background: Background) -> Image:
    """Tileable floor of a room, or open ground (512, 512, 3), from the background's seed."""
    rng = stream(background.seed, "sample", 0, 0, "floor texture")
    if background.kind == "outdoor":
        return _ground(rng)
    kind = int(rng.integers(4))
    if kind == 0:
        return _planks(rng, int(rng.integers(5, 11)))
    tone = rng.uniform(0.05, 0.5) * np.array([1.0, rng.uniform(0.85, 1.0), rng.uniform(0.7, 1.0)])
    if kind == 1:  # tiles with joints
        n = int(rng.integers(2, 5))
        steps = np.arange(TEXTURE_PX) / TEXTURE_PX * n % 1
        joint = (steps < 0.02)[:, None] | (steps < 0.02)[None]
        each = 1 + 0.06 * rng.standard_normal((n, n))
        shade = np.kron(each, np.ones((TEXTURE_PX // n + 1,) * 2))[:TEXTURE_PX, :TEXTURE_PX]
        return _tinted(np.where(joint, 0.45, shade * (1 + 0.05 * _cloud(rng, 20))), tone)
    if kind == 2:  # carpet
        return _tinted(1 + 0.22 * _cloud(rng, 1) + 0.08 * _cloud(rng, 40), tone)
    return _tinted(1 + 0.05 * _cloud(rng, 2) + 0.1 * _cloud(rng, 60), tone)  # screed


def _ground(rng: np.random.Generator) -> Image:
    """Grass, soil, asphalt, gravel or paving."""
    kind = int(rng.integers(5))
    fine, coarse = _cloud(rng, 1), _cloud(rng, 30)
    if kind == 0:
        blades = np.asarray(cv2.blur(_cloud(rng, 1), (1, 9)))
        green = np.array([0.055, 0.1, 0.03]) * rng.uniform(0.7, 1.5)
        straw = np.array([0.18, 0.15, 0.07])
        share = np.clip(0.25 + 0.25 * coarse, 0, 1)[..., None]
        both = (1 - share) * green + share * straw
        return np.asarray(np.clip(both * (1 + 0.45 * blades + 0.2 * fine)[..., None], 0.005, 0.9),
                          np.float32)  # fmt: skip
    if kind == 1:
        return _tinted(1 + 0.2 * fine + 0.25 * coarse + 0.2 * _cloud(rng, 8), [0.16, 0.11, 0.07])
    if kind == 2:
        return _tinted(1 + 0.25 * fine + 0.08 * coarse, [0.1, 0.1, 0.105])
    if kind == 3:
        return _tinted(1 + 0.5 * _cloud(rng, 4) + 0.2 * fine, [0.28, 0.26, 0.23])
    steps = np.arange(TEXTURE_PX) / TEXTURE_PX * 4
    row = np.floor(steps)[:, None]
    along = (steps[None] + 0.5 * (row % 2)) % 1
    joint = (along < 0.04) | ((steps % 1 < 0.04)[:, None])
    return _tinted(np.where(joint, 0.4, 1 + 0.1 * coarse + 0.12 * fine), [0.3, 0.27, 0.24])


def _tinted(shade: Array | Image, colour: Array | list[float]) -> Image:
    return np.asarray(np.clip(shade[..., None] * np.array(colour), 0.005, 0.92), np.float32)


def _planks(rng: np.random.Generator, count: int) -> Image:
    """Wood in boards: each with its own shade and grain along it."""
    wood = rng.uniform(0.25, 1.1) * np.array([0.46, 0.29, 0.16])
    height = -(-TEXTURE_PX // count)
    grain = _grain(rng)
    rows = np.arange(TEXTURE_PX)
    board = rows // height
    shade = 1 + 0.16 * rng.standard_normal(count)[board]
    shift = rng.integers(0, TEXTURE_PX, count)[board]
    columns = (np.arange(TEXTURE_PX)[None] + shift[:, None]) % TEXTURE_PX
    light = shade[:, None] * (1 + 0.14 * grain[rows[:, None], columns])
    joint = (rows % height < 2)[:, None] | (columns < 2)
    return _tinted(np.where(joint, 0.3 * light, light), wood)


def _grain(rng: np.random.Generator) -> Image:
    """Streaks along x with unit standard deviation, tileable."""
    streaks = rng.standard_normal((TEXTURE_PX, 8)).astype(np.float32)
    wide = np.asarray(cv2.resize(np.hstack([streaks, streaks[:, :1]]), (TEXTURE_PX,) * 2))
    bent = 0.6 * wide + 0.5 * np.sin(6 * _cloud(rng, 60) + 0.3 * wide) + 0.25 * _cloud(rng, 2)
    return np.asarray(bent / bent.std(), np.float32)


def table_texture(table: Thing) -> Image:
    """Tileable top of a table (512, 512, 3): wood, laminate, stone or cloth."""
    rng = stream(table.seed, "sample", 0, 0, "table texture")
    colour = np.array(table.colour_rgb)
    kind = int(rng.integers(5))
    if kind < 2:
        return _planks(rng, int(rng.integers(2, 5)))
    if kind == 2:
        return _tinted(1 + 0.03 * _cloud(rng, 3), colour)
    if kind == 3:
        vein = np.exp(-8 * np.abs(_cloud(rng, 30) + 0.4 * _cloud(rng, 8)))
        return _tinted(1 + 0.15 * _cloud(rng, 50) - 0.25 * vein, colour)
    return _weave(rng, colour, np.array(table.accent_rgb), "checks" if rng.random() < 0.4 else "")


def sleeve_texture(sleeve: Sleeve) -> Image:
    """Cloth around an arm (512, 512, 3); u runs around it."""
    rng = stream(sleeve.seed, "sample", 0, 0, "cloth")
    colours = np.array(sleeve.colour_rgb), np.array(sleeve.accent_rgb)
    return _weave(rng, *colours, sleeve.pattern)


def _weave(rng: np.random.Generator, colour: Array, accent: Array, pattern: str) -> Image:
    """Cloth: threads under and over, worn unevenly; striped or checked in two colours."""
    y, x = np.mgrid[:TEXTURE_PX, :TEXTURE_PX]
    threads = 0.08 * np.where((x // 2 + y // 2) % 2, 1, -1) + 0.07 * _cloud(rng, 1)
    shade = 1 + threads + 0.06 * _cloud(rng, 24)
    n = int(rng.integers(4, 14))
    across, down = (x * n // TEXTURE_PX) % 2, (y * n // TEXTURE_PX) % 2
    share = {"stripes": down, "checks": (across + down) / 2}.get(pattern, np.zeros_like(x))
    both = colour + np.asarray(share)[..., None] * (accent - colour)
    return np.asarray(np.clip(shade[..., None] * both, 0.005, 0.92), np.float32)


# The atlas of small things: square cells, one per slot.
CELLS, CELL_PX = 7, 80
assert CELLS**2 >= MOST_BOXES + MOST_TURNED
ATLAS_PX = CELLS * CELL_PX


def atlas_uv(uv: Array, slot: int) -> Array:
    """Map a thing's texture coordinates (n, 2) in [0, 1] into its cell, clear of neighbours."""
    cell = np.array([slot % CELLS, slot // CELLS])
    inset = 2 / CELL_PX
    return np.asarray((cell + inset + (1 - 2 * inset) * uv) / CELLS)


def things_atlas(things: tuple[Thing, ...]) -> tuple[Image, Image]:
    """Reflectance (n, n, 3) and roughness (n, n, 1) of every box and turned body, by slot."""
    colour = np.full((ATLAS_PX, ATLAS_PX, 3), 0.3, np.float32)
    rough = np.full((ATLAS_PX, ATLAS_PX, 1), 0.6, np.float32)
    boxes = [t for t in things if t.shape == "box" and t.role != "support"]
    turned = [t for t in things if t.shape != "box"]
    slots = list(enumerate(boxes)) + [(MOST_BOXES + k, t) for k, t in enumerate(turned)]
    for slot, thing in slots:
        row, column = slot // CELLS, slot % CELLS
        # Texture coordinates start bottom left, pictures at the top.
        rows = slice((CELLS - 1 - row) * CELL_PX, (CELLS - row) * CELL_PX)
        columns = slice(column * CELL_PX, (column + 1) * CELL_PX)
        colour[rows, columns] = _cell(thing)
        rough[rows, columns] = thing.roughness
    return colour, rough


def _cell(thing: Thing) -> Image:
    rng = stream(thing.seed, "sample", 0, 0, "thing texture")
    y, x = np.mgrid[:CELL_PX, :CELL_PX] / CELL_PX
    kind = int(rng.integers(6))
    if kind == 0:  # a label
        low, high = sorted(rng.uniform(0.1, 0.9, 2))
        share = ((y > low) & (y < high)).astype(float)
    elif kind == 1:
        share = (np.floor(y * rng.integers(3, 9)) % 2) * 1.0
    elif kind == 2:
        centre = rng.random((12, 2))
        gap = np.hypot(x[..., None] - centre[:, 0], y[..., None] - centre[:, 1]).min(axis=-1)
        share = (gap < 0.08).astype(float)
    else:
        share = np.zeros_like(x)
    noise = rng.standard_normal((CELL_PX, CELL_PX)).astype(np.float32)
    blotch = np.asarray(cv2.GaussianBlur(noise, (0, 0), 1 + 5 * rng.random()))
    shade = 1 + 0.12 * blotch / blotch.std() * (1.5 if thing.roughness > 0.8 else 0.6)
    a, b = np.array(thing.colour_rgb), np.array(thing.accent_rgb)
    return np.asarray(np.clip((a + share[..., None] * (b - a)) * shade[..., None], 0.005, 0.92),
                      np.float32)  # fmt: skip


# The atlas of bands: one row of cells, each split into the band's and the watch's face.
BAND_CELLS = 4


def band_uv(uv: Array, slot: int) -> Array:
    """Map a band's texture coordinates (n, 2) into its cell: lower half band, upper half case."""
    case = uv[:, 1] > 0.5
    return np.stack([(slot + 0.5 + 0 * uv[:, 0]) / BAND_CELLS, np.where(case, 0.75, 0.25)], axis=1)


def bands_atlas(bands: tuple[Band, ...]) -> tuple[Image, Image, Image]:
    """Colour (2, 4, 3), roughness and metallic (2, 4, 1) of up to four bands."""
    colour = np.full((2, BAND_CELLS, 3), 0.3, np.float32)
    rough, metal = np.full((2, BAND_CELLS, 1), 0.5, np.float32), np.zeros((2, BAND_CELLS, 1))
    for k, band in enumerate(bands[:BAND_CELLS]):
        colour[:, k] = band.colour_rgb
        rough[:, k], metal[:, k] = (0.22, 1.0) if band.metal else (0.55, 0.0)
        if band.kind == "watch":
            colour[0, k], rough[0, k], metal[0, k] = (0.03, 0.03, 0.035), 0.12, 0.0
    return colour, rough, metal.astype(np.float32)


def photo_texture(background: Background) -> Image:
    """Return the user's picture, cut square from its middle (n, n, 3)."""
    assert background.file is not None
    image = read_image(background.file)
    n = min(image.shape[:2])
    y, x = (image.shape[0] - n) // 2, (image.shape[1] - n) // 2
    cut = cv2.resize(image[y : y + n, x : x + n], (TEXTURE_PX,) * 2, interpolation=cv2.INTER_AREA)
    return np.asarray(np.clip(cut, 0.005, 0.95), np.float32)
