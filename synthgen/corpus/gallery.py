"""Looking at a corpus: one static HTML file, and a contact sheet."""

from __future__ import annotations

import base64
import html
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.corpus import atomic
from synthgen.corpus.reading import Corpus, open_corpus
from synthgen.corpus.sample import Sample, View
from synthgen.errors import CorpusError
from synthgen.models.joints import OPENPOSE21_BONES

Image = NDArray[np.uint8]
MOST = 200
THUMB_PX = 224
# One colour per finger: thumb, index, middle, ring, pinky.
FINGER_RGB = ((230, 60, 60), (240, 160, 30), (90, 200, 80), (60, 150, 240), (180, 90, 230))
STATE_WORDS = ("out of frame", "occluded", "visible")


def write_gallery(path: str | Path, out: str | Path | None = None) -> Path:
    """Write a gallery of a corpus: thumbnails with overlays, histograms of sampled factors.

    Parameters
    ----------
    path : str or Path
        A finished corpus; its first 200 samples are shown.
    out : str or Path or None
        The HTML file; ``path/gallery.html`` by default. It needs no other file and no network.
    """
    corpus = open_corpus(path)
    file = Path(out) if out is not None else Path(path) / "gallery.html"
    shown = [corpus[k] for k in range(min(len(corpus), MOST))]
    cards = "\n".join(_cards(sample) for sample in shown)
    page = _PAGE.format(
        title=html.escape(Path(path).resolve().name),
        count=len(corpus),
        note="" if len(corpus) <= MOST else f" - the first {MOST} are shown",
        hash=html.escape(corpus.manifest["config_hash"][:12]),
        histograms=_histograms(corpus),
        cards=cards,
    )
    atomic.make_folder(file.resolve().parent)
    atomic.replace(file, page.encode())
    return file


def contact_sheet(path: str | Path, out: str | Path, columns: int = 6) -> Path:
    """Write the pictures of a corpus (of its first 200 samples) as one JPEG sheet.

    Raises
    ------
    CorpusError
        If the corpus is empty.
    """
    corpus = open_corpus(path)
    pictures = [view.image for k in range(min(len(corpus), MOST)) for view in corpus[k].views]
    if not pictures:
        raise CorpusError(f"{path} holds no sample; `synthgen generate` makes some")
    columns = min(columns, len(pictures))
    rows = [pictures[k : k + columns] for k in range(0, len(pictures), columns)]
    blank = np.full_like(pictures[0], 255)
    sheet = np.concatenate(
        [np.concatenate(row + [blank] * (columns - len(row)), axis=1) for row in rows]
    )
    data = cv2.imencode(".jpg", sheet[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 84])[1]
    atomic.make_folder(Path(out).resolve().parent)
    atomic.replace(Path(out), data.tobytes())
    return Path(out)


def skeleton_picture(view: View) -> Image:
    """Draw every hand's keypoints and bones over the picture; occluded bones are dark."""
    canvas = np.ascontiguousarray(view.image.copy())
    for hand in view.hands:
        points = [tuple(round(float(v)) for v in p) for p in hand.keypoints_2d]
        for a, b in OPENPOSE21_BONES:
            seen = hand.keypoints_state[b] == 2
            colour = tuple(int(c * (1 if seen else 0.4)) for c in FINGER_RGB[(b - 1) // 4])
            cv2.line(canvas, points[a], points[b], colour, 1, cv2.LINE_AA)
    return canvas


def parts_picture(view: View) -> Image:
    """Colour each part."""
    hues = (np.arange(256) * 47 % 180).astype(np.uint8)
    table = np.stack([hues, np.full(256, 190, np.uint8), np.full(256, 230, np.uint8)], axis=-1)
    colours = cv2.cvtColor(table[None], cv2.COLOR_HSV2RGB)[0]
    colours[0] = 24
    return np.asarray(colours[view.part_id], dtype=np.uint8)


def depth_picture(view: View, shown: NDArray[np.float32] | None = None) -> Image:
    """Colour depth around the hand: near is bright; nothing is black.

    ``shown`` (H, W) is another depth of the view, such as its sensor's, in the same colours.
    """
    z, hand = view.depth_z_m, view.instance_id > 0
    near, far = (z[hand].min(), z[hand].max()) if hand.any() else (z.min(), z.max() + 1e-3)
    depth = z if shown is None else shown
    share = np.clip((far + 0.1 - depth) / (far + 0.1 - near), 0, 1)
    coloured = cv2.applyColorMap((255 * share).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    coloured[depth == 0] = 0
    return np.ascontiguousarray(coloured[..., ::-1])


def _cards(sample: Sample) -> str:
    """One figure per view, and one per picture of the scan where there is one."""
    figures = [_card(view) for view in sample.views]
    if sample.scan is not None:
        from synthgen.corpus.scan_pictures import scan_pictures

        key = sample.views[0].key
        figures += [
            f'<figure><img class="scan" src="{_inline(picture, 80, 2 * THUMB_PX)}" alt="{name}">'
            f"<figcaption>{key} &middot; {name}</figcaption></figure>"
            for name, picture in scan_pictures(sample.scan).items()
        ]
    return "".join(figures)


def _card(view: View) -> str:
    layers = {
        "photo": _inline(view.image, 85),
        "parts": _inline(parts_picture(view), 70),
    }
    if "depth" in view.columns:
        layers["depth"] = _inline(depth_picture(view), 70)
    images = "".join(f'<img class="{n}" src="{d}" alt="{n}">' for n, d in layers.items())
    factors = view.meta["spec"]["factors"]
    lines = "".join(
        f"<tr><td>{html.escape(k)}</td><td>{html.escape(_short(v))}</td></tr>"
        for k, v in sorted(factors.items())
    )
    return (
        f'<figure><div class="stack">{images}{_skeleton(view)}</div><figcaption>'
        f"<details><summary>{view.key} &middot; {factors.get('hand', '')}</summary>"
        f"<table>{lines}</table></details></figcaption></figure>"
    )


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _inline(image: Image, quality: int, across: int = THUMB_PX) -> str:
    height, width = image.shape[:2]
    size = (across, max(1, round(across * height / width)))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    data = cv2.imencode(".jpg", small[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()


def _skeleton(view: View) -> str:
    """SVG in the picture's own pixels; bones end in a dot, hollow where occluded."""
    w, h = view.meta["width"], view.meta["height"]
    r = max(w, h) / 110
    shapes = []
    for hand in view.hands:
        p, state = hand.keypoints_2d, hand.keypoints_state
        for a, b in OPENPOSE21_BONES:
            colour = f"rgb{FINGER_RGB[(b - 1) // 4]}"
            dash = "" if state[b] == 2 else f' stroke-dasharray="{r:.1f}"'
            shapes.append(
                f'<line x1="{p[a][0]:.1f}" y1="{p[a][1]:.1f}" x2="{p[b][0]:.1f}" '
                f'y2="{p[b][1]:.1f}" stroke="{colour}" stroke-width="{r * 0.7:.2f}"{dash}/>'
                f'<circle cx="{p[b][0]:.1f}" cy="{p[b][1]:.1f}" r="{r:.2f}" stroke="{colour}" '
                f'stroke-width="{r * 0.4:.2f}" fill="{colour if state[b] == 2 else "none"}">'
                f"<title>{b}: {STATE_WORDS[int(state[b])]}</title></circle>"
            )
    return f'<svg class="bones" viewBox="-0.5 -0.5 {w} {h}">{"".join(shapes)}</svg>'


def _histograms(corpus: Corpus) -> str:
    """Draw the factors that vary; of the others say what they are."""
    skipped = {"key", "sample", "view", "shard", "subject_id", "hands"}
    told = {name: values for name, values in sorted(corpus.table.to_pydict().items())
            if name not in skipped and values}  # fmt: skip
    fixed = {name: values[0] for name, values in told.items() if len(set(values)) == 1}
    drawn = [_histogram(name, values) for name, values in told.items() if name not in fixed]
    words = " &middot; ".join(f"{html.escape(name)} {html.escape(_short(value))}"
                              for name, value in fixed.items() if value is not None)  # fmt: skip
    same = f"<p>The same in all: {words}</p>" if words else ""
    return f'<div class="hists">{"".join(drawn)}</div>{same}'


def _histogram(name: str, values: list[Any]) -> str:
    known = [v for v in values if v is not None]
    if isinstance(known[0], str) or len(set(known)) == 1:
        known = [_short(value) for value in known]
        labels = sorted(set(known))
        counts = [known.count(label) for label in labels]
    else:
        tally, edges = np.histogram(np.array(known, dtype=np.float64), bins=12)
        counts, labels = tally.tolist(), [f"{edges[0]:.3g}", f"{edges[-1]:.3g}"]
    top, width = max(counts), 168 / len(counts)
    bars = "".join(
        f'<rect x="{k * width:.1f}" y="{60 - 56 * n / top:.1f}" width="{width - 2:.1f}" '
        f'height="{56 * n / top:.1f}"><title>{n}</title></rect>'
        for k, n in enumerate(counts)
    )
    text = " &middot; ".join(html.escape(str(label)) for label in labels)
    return (
        f'<div class="hist"><b>{html.escape(name)}</b>'
        f'<svg viewBox="0 0 168 60">{bars}</svg><small>{text}</small></div>'
    )


_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1"><title>{title}</title>
<style>
:root {{ color-scheme: light dark;
  --ink: light-dark(#1c1f24, #e8e9ec); --soft: light-dark(#667, #99a);
  --card: light-dark(#fff, #1d2026); --page: light-dark(#f3f4f6, #121419); --bar: #4a86c8; }}
body {{ font: 15px/1.45 system-ui, sans-serif; margin: 0 auto; padding: 24px; max-width: 1500px;
  color: var(--ink); background: var(--page); }}
h1 {{ font-size: 22px; margin: 0 }} p {{ color: var(--soft); margin: 4px 0 16px }}
nav {{ position: sticky; top: 0; background: var(--page); padding: 10px 0; z-index: 2 }}
nav label {{ margin-right: 18px; cursor: pointer }}
.hists {{ display: flex; flex-wrap: wrap; gap: 14px; margin-bottom: 20px }}
.hist {{ background: var(--card); padding: 10px 12px; border-radius: 8px; width: 168px }}
.hist b {{ font-size: 13px }} .hist small {{ color: var(--soft); display: block; font-size: 11px }}
.hist rect {{ fill: var(--bar) }}
main {{ display: grid; grid-template-columns: repeat(auto-fill, minmax(200px, 1fr)); gap: 14px }}
figure {{ margin: 0; background: var(--card); border-radius: 8px; overflow: hidden }}
.scan {{ width: 100% }} .stack {{ position: relative }} .stack img {{ display: block; width: 100% }}
.stack svg {{ position: absolute; inset: 0; width: 100%; height: 100% }}
figcaption {{ padding: 6px 10px; font-size: 12px }} td {{ padding-right: 10px; color: var(--soft) }}
.parts, .depth, .bones {{ display: none !important }}
body:has(#parts:checked) .parts, body:has(#depth:checked) .depth {{ display: block !important }}
body:has(#parts:checked) .photo, body:has(#depth:checked) .photo {{ display: none }}
body:has(#bones:checked) .bones {{ display: block !important }}
</style>
<h1>{title}</h1><p>{count} samples{note} &middot; config {hash}</p>
{histograms}
<nav><label><input type="radio" name="layer" checked> picture</label>
<label><input type="radio" name="layer" id="parts"> parts</label>
<label><input type="radio" name="layer" id="depth"> depth</label>
<label><input type="checkbox" id="bones" checked> skeleton</label></nav>
<main>
{cards}
</main></html>
"""
