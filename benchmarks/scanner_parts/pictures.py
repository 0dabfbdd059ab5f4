"""Pictures of the self-test: error maps with their holes, scans, profiles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from synthgen.corpus.scan_pictures import scan_pictures
from synthgen.scanner import Scan, UnitScan

RANGE_MM = 0.2
HOLE, INVENTED = (0.85, 0.1, 0.75), (0.1, 0.1, 0.1)


def figure(width: float = 9, height: float = 4) -> Figure:
    """Return an empty figure that saves without a display."""
    made = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(made)
    return made


def error_maps(units: list[tuple[str, UnitScan]], path: Path) -> None:
    """Write depth errors of measurements side by side, cut to what is there."""
    made = figure(max(3.6 * len(units) + 1, 7), 4.2)
    shown: Any = None
    for k, (title, unit) in enumerate(units):
        axes: Any = made.add_subplot(1, len(units), k + 1)
        assert unit.true_disparity is not None
        found, true = (unit.pair.depth(d) for d in (unit.disparity, unit.true_disparity))
        seen, matched = np.isfinite(true), np.isfinite(found)
        rows, columns = np.nonzero(seen | matched)
        cut = slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)
        shown = axes.imshow(1e3 * (found - true)[cut], cmap="turbo", vmin=-RANGE_MM, vmax=RANGE_MM)
        for mask, colour in ((seen & ~matched, HOLE), (matched & ~seen, INVENTED)):
            layer = np.zeros((*seen.shape, 4))
            layer[mask] = (*colour, 1.0)
            axes.imshow(layer[cut])
        axes.set(title=title, xticks=[], yticks=[])
    made.colorbar(shown, ax=made.axes, label="depth error, mm", shrink=0.8)
    made.supxlabel("magenta: seen by both cameras, not matched; black: matched, seen by one only")
    made.savefig(path, dpi=110)


def scan_sheet(found: Scan, path: Path) -> None:
    """Write what the gallery shows of a scan: signed error, the scan with its holes, disparity."""
    pictures = scan_pictures(found)
    height = 420
    row = [p if p.shape[0] == height else _fitted(p, height)
           for name, p in pictures.items() if name != "speckle"]  # fmt: skip
    cv2.imwrite(str(path), np.concatenate(row, axis=1)[..., ::-1])


def _fitted(picture: Any, height: int) -> Any:
    width = round(picture.shape[1] * height / picture.shape[0])
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
