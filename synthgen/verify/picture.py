"""Checks of the picture itself: it must show what the labels say, whatever made either.

No renderer and no model: colour of skin, and edges where the labels have theirs. They are the only
witness where picture and labels are both sound, but not of the same sample.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from synthgen.corpus.sample import Sample, View
from synthgen.models.joints import PART_FOREARM
from synthgen.verify.redraw import Redrawn
from synthgen.verify.report import Record

Array = NDArray[np.float64]

# Red over blue of the bluest skylight; mean of a skin that has no hue.
SKY_HUE, DARKEST = 0.6, 4
# An edge is found where it changes more than 60 % of its surroundings do. Measured on 240 pictures
# (plain and full, few light paths) and on as many with the labels of the next: share found plus
# SHADING times the gain is over 0.75 for true labels, and under 0.62 for all but two foreign ones.
STANDS_OUT, SHADING, FITS = 0.6, 1.5, 0.68
AROUND_PX = (8, 16, 24)
BESIDE_PX, WINDOW_PX = (6, 12), 31
RIM_PX, STRETCH_PX, FEWEST_PX, FEWEST_SKIN = 30, 25, 100, 50


def check_image(record: Record, sample: Sample, view: View, again: Redrawn) -> None:
    """Check that the picture shows this scene: skin is red over blue, edges where labels have."""
    skin = (view.part_id > 0) & (view.part_id <= PART_FOREARM)
    if skin.sum() < FEWEST_SKIN:
        for check in ("skin hue", "stale image", "mirrored image"):
            record.skip(check, f"fewer than {FEWEST_SKIN} pixels show skin")
        return
    mean = view.image[skin].astype(np.float64).mean(axis=0)
    if mean.max() < DARKEST:
        record.skip("skin hue", f"skin is darker than {DARKEST} of 255")
    elif _redness(sample) > 1.1:
        record.measure("skin hue", mean[2] - mean[0], 0.0,
                       "skin is bluer than red; channels swapped?")  # fmt: skip
    else:
        record.skip("skin hue", "the light may be bluer than skin is red")
    depth = view.depth_z_m if "depth" in view.columns else again.depth_z_m
    edges = outline(view.instance_id.astype(np.int64), depth)
    found, gain = found_share(view.image, edges), shading_gain(view)
    if found is None:
        record.skip("stale image", f"fewer than {FEWEST_PX} pixels of outline lie {RIM_PX} px "
                    "inside the picture")  # fmt: skip
    else:
        seen = f"{100 * found:.0f} % of the labels' edges are there, shading explains {gain:+.2f}"
        record.measure("stale image", -(found + SHADING * gain), -FITS,
                       f"not this picture: {seen}")  # fmt: skip
    mirrored = _mirrored_gain(view.image, edges)
    if mirrored is None:
        record.skip("mirrored image", "the labels have no outline in the picture")
    else:
        record.measure("mirrored image", mirrored, 1.0,
                       "edges follow the mirrored labels, not the labels")  # fmt: skip


def _redness(sample: Sample) -> float:
    """Least red over blue of the skins as the picture may show them, by the truth.

    A camera that balances white leaves a quarter of the light's hue (in its logarithm), and its
    own error.
    """
    scene = sample.spec.scene
    colours = [scene.lights.constant_rgb, *(lamp.radiance_rgb for lamp in scene.lights.area)]
    hues = [c[0] / max(c[2], 1e-9) for c in colours if sum(c) > 0]
    hues += [SKY_HUE] if scene.lights.sky is not None else []
    balanced = scene.sensor.white_balance
    light = min(hues) ** (0.25 if balanced else 1.0)
    error = scene.sensor.balance_error
    skins = [s.skin.dorsal_rgb[0] / s.skin.dorsal_rgb[2] for s in scene.subjects]
    return float(min(skins) * light * error[0] / error[2])


def outline(instance: NDArray[np.int64], depth_z_m: NDArray[Any]) -> NDArray[np.bool_]:
    """Pixels (H, W) where instances meet, or depth jumps by over 5 % within one."""
    hand = instance > 0
    z = np.log(np.maximum(depth_z_m, 1e-3))
    edge = np.zeros(instance.shape, dtype=bool)
    for first, second in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        jump = (np.abs(z[first] - z[second]) > 0.05) & hand[first] & hand[second]
        edge[first] |= (instance[first] != instance[second]) | jump
    return edge


def found_share(image: NDArray[np.uint8], edges: NDArray[np.bool_]) -> float | None:
    """Share of an outline (H, W) that is there in a picture (H, W, 3); None: too little to tell.

    At each edge pixel the change of colour across the edge is compared with that in the same
    direction at 24 places 8 to 24 px away: 0.5 of them are less by chance, whatever the contrast.
    A stretch of the outline is found where that share, its mean over 25 px, exceeds 60 %.
    """
    at = np.argwhere(edges)
    size = np.array(edges.shape)
    at = at[np.all((at >= RIM_PX) & (at < size - RIM_PX), axis=1)]
    if len(at) < FEWEST_PX:
        return None
    down, right = _across(edges)[:, at[:, 0], at[:, 1]]
    slope = _slopes(image)

    def change(rows: int, columns: int) -> Array:
        r, c = at[:, 0] + rows, at[:, 1] + columns
        turned = slope[0, r, c] * down[:, None] + slope[1, r, c] * right[:, None]
        return np.asarray(np.abs(turned).sum(axis=1))

    here = change(0, 0)
    turns = np.arange(8) * np.pi / 4
    around = [change(round(r * np.sin(a)), round(r * np.cos(a))) for r in AROUND_PX for a in turns]
    rank = np.mean(here > np.array(around), axis=0)
    total, count = np.zeros(edges.shape), np.zeros(edges.shape)
    total[tuple(at.T)], count[tuple(at.T)] = rank, 1
    local = ndimage.uniform_filter(total, STRETCH_PX)[tuple(at.T)]
    local /= ndimage.uniform_filter(count, STRETCH_PX)[tuple(at.T)]
    return float(np.mean(local > STANDS_OUT))


def _across(edges: NDArray[np.bool_]) -> Array:
    """Return unit directions (2, H, W), down and right, across an outline."""
    soft = [ndimage.gaussian_filter(edges.astype(np.float64), 2.0, order=k)
            for k in ((2, 0), (1, 1), (0, 2))]  # fmt: skip
    # The principal direction of curvature of the blurred outline, a ridge along it.
    angle = 0.5 * np.arctan2(2 * soft[1], soft[0] - soft[2])
    down, right = np.cos(angle), np.sin(angle)
    bend = soft[0] * down**2 + 2 * soft[1] * down * right + soft[2] * right**2
    ridge = bend < soft[0] + soft[2] - bend  # the more negative of the two
    return np.stack([np.where(ridge, down, -right), np.where(ridge, right, down)])


def _slopes(image: NDArray[np.uint8]) -> Array:
    """Return changes per 4 px (2, H, W, 3), down and right, of the picture without its noise."""
    soft = np.asarray(cv2.GaussianBlur(image.astype(np.float64), (0, 0), 1.2), dtype=np.float64)
    slope = np.zeros((2, *soft.shape))
    slope[0, 2:-2] = soft[4:] - soft[:-4]
    slope[1, :, 2:-2] = soft[:, 4:] - soft[:, :-4]
    return slope


def shading_gain(view: View) -> float:
    """Return how much better the labels explain the picture here than beside it.

    Explained share of the variance (R^2) in a window around the hand, by its mask and by smooth
    shading of its normals (second order spherical harmonics, Ramamoorthi and Hanrahan 2001), less
    its mean with the labels 6 and 12 px off.
    """
    hand = ((view.part_id > 0) & (view.part_id <= PART_FOREARM)).astype(np.uint8)
    window = cv2.dilate(hand, np.ones((WINDOW_PX, WINDOW_PX), np.uint8)).astype(bool)
    r, c = np.nonzero(window[::2, ::2])
    r, c = 2 * r, 2 * c
    on = hand[r, c].astype(np.float64)
    x, y, z = (view.normals[r, c].astype(np.float64) * on[:, None]).T
    basis = np.stack([np.ones_like(on), on, x, y, z, x * y, y * z, x * z, x * x - y * y,
                      3 * z * z - on], axis=1)  # fmt: skip
    solve = np.linalg.pinv(basis)
    tone = np.log(cv2.GaussianBlur(view.image, (0, 0), 1.0).astype(np.float64) + 8)

    def explained(rows: int, columns: int) -> float:
        seen = tone[(r + rows) % tone.shape[0], (c + columns) % tone.shape[1]]
        seen = seen - seen.mean(axis=0)
        rest = seen - basis @ (solve @ seen)
        return float(1 - np.sum(rest**2) / max(np.sum(seen**2), 1e-12))

    turns = np.arange(8) * np.pi / 4
    beside = [explained(round(d * np.sin(a)), round(d * np.cos(a))) for d in BESIDE_PX
              for a in turns]  # fmt: skip
    return explained(0, 0) - float(np.mean(beside))


def _mirrored_gain(image: NDArray[np.uint8], edges: NDArray[np.bool_]) -> float | None:
    """Image contrast across the labels' edges mirrored over that across the edges."""
    grey = image.astype(np.float64) @ [0.299, 0.587, 0.114]
    grey = np.asarray(cv2.GaussianBlur(grey, (0, 0), 1.0), dtype=np.float64)
    at = np.argwhere(edges)
    flipped = np.stack([at[:, 0], grey.shape[1] - at[:, 1]], axis=1)
    here, there = _contrast(grey, at), _contrast(grey, flipped)
    return None if here is None or there is None else there / max(here, 1e-6)


def _contrast(grey: Array, where: NDArray[np.int64]) -> float | None:
    size = np.array(grey.shape)
    inside = where[np.all((where >= 3) & (where < size - 3), axis=1)]
    if len(inside) == 0:
        return None
    r, c = inside.T
    step = np.abs(grey[r + 2, c] - grey[r - 3, c]) + np.abs(grey[r, c + 2] - grey[r, c - 3])
    return float(step.mean())
