"""The round trip as one HTML file: worst cases first, with pictures."""

from __future__ import annotations

import base64
import html
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.registration.overlay import draw_overlay
from synthgen.verify.roundtrip import HandTrip, RoundTrip

Array = NDArray[np.float64]
PICTURES = 40


def write_page(path: Path, trip: RoundTrip, title: str) -> None:
    """Write the page; it needs no other file and no network."""
    counts = ", ".join(f"{n} {verdict}" for verdict, n in trip.counts.items())
    worst = trip.worst_first
    rows = "\n".join(_row(hand) for hand in worst)
    cards = "\n".join(_card(hand) for hand in worst[:PICTURES] if hand.fit is not None)
    state = "no alarm" if trip.ok else "TRUTH MISMATCH"
    page = _PAGE.format(
        title=html.escape(title),
        start=html.escape(trip.start),
        counts=counts,
        state=state,
        rows=rows,
        cards=cards,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page, encoding="utf-8")


def _row(hand: HandTrip) -> str:
    f = hand.figures
    numbers = [f.get(name) for name in ("v2v_mean_mm", "v2v_seen_mean_mm", "surface_seen_mm",
                                        "joints_mean_mm", "rotation_deg", "coverage_all",
                                        "truth_explains", "floor_ratio")]  # fmt: skip
    cells = "".join(f"<td>{'' if v is None else f'{v:.2f}'}</td>" for v in numbers)
    words = (hand.sample, hand.hand_number, hand.verdict, hand.reason, hand.source)
    first = "".join(f"<td>{html.escape(str(word))}</td>" for word in words)
    return f'<tr class="{html.escape(hand.verdict.split()[0])}">{first}{cells}</tr>'


def _card(hand: HandTrip) -> str:
    """Pictures of a fit and, where it did not pass, of the truth in its place."""
    assert hand.fit is not None
    points = np.zeros((0, 3)) if hand.points is None else hand.points
    title = f"sample {hand.sample}, hand {hand.hand_number}: {hand.verdict} {hand.reason}"
    pictures = [_picture(points, hand.fit.vertices, hand.fit.model.faces, "the fit")]
    if hand.verdict != "pass" and hand.truth is not None:
        pictures.append(_picture(points, hand.truth, hand.fit.model.faces, "the truth"))
    return f"<figure>{''.join(pictures)}<figcaption>{html.escape(title)}</figcaption></figure>"


def _picture(points: Array, vertices: Array, faces: NDArray[Any], what: str) -> str:
    picture = draw_overlay(points, vertices, faces, what)
    data = cv2.imencode(".jpg", np.ascontiguousarray(picture[..., ::-1]),
                        [cv2.IMWRITE_JPEG_QUALITY, 80])[1]  # fmt: skip
    text = base64.b64encode(data.tobytes()).decode()
    return f'<img alt="{what}" src="data:image/jpeg;base64,{text}">'


_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}: round trip</title>
<style>
body {{ font: 15px/1.4 system-ui, sans-serif; margin: 2em auto; max-width: 1200px; padding: 0 1em;
  color: #222; background: #fff }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums }}
td, th {{ padding: .2em .6em; text-align: right; border-bottom: 1px solid #ddd }}
td:nth-child(-n+5), th:nth-child(-n+5) {{ text-align: left }}
tr.truth_mismatch {{ background: #fdd }} tr.fail {{ background: #ffe9d0 }}
tr.unobserved {{ background: #fffbd6 }}
td:nth-child(4) {{ min-width: 13em }} figure {{ margin: 1.5em 0 0 }}
img {{ width: 520px; max-width: 49% }}
figcaption {{ font-size: 13px; color: #555 }}
</style>
<h1>{title}: round trip from {start}</h1>
<p><b>{state}</b>: {counts}. Worst first. Left to right in each picture: the stored points; points
over the surface; the surface coloured by their distance (green 0, red 1 mm and more, grey not
seen). What did not pass is shown twice: as fitted, and as it truly was.</p>
<table><thead><tr><th>sample<th>hand<th>verdict<th>reason<th>source<th>v2v mm<th>v2v seen
<th>surface seen<th>joints mm<th>rotation deg<th>coverage<th>truth explains<th>x floor</tr></thead>
<tbody>
{rows}
</tbody></table>
{cards}
</html>
"""
