"""The round trip as one HTML file: worst cases first, with pictures."""

from __future__ import annotations

import base64
import html
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.subdivision import InterpolatingSubdivision
from synthgen.registration.overlay import draw_overlay
from synthgen.scene.surface import LEVELS
from synthgen.verify.report import VerifyReport
from synthgen.verify.roundtrip import HandTrip, RoundTrip

Array = NDArray[np.float64]
PICTURES = 40
FAR_M = 0.3  # what looks at a fit does not see a truth beyond


def write_page(path: Path, trip: RoundTrip, title: str, labels: VerifyReport | None = None) -> None:
    """Write the page, of one file; ``labels`` is what the checks of labels found."""
    worst = trip.worst_first
    page = _PAGE.format(
        title=html.escape(title),
        start=html.escape(trip.start),
        counts=", ".join(f"{n} {verdict}" for verdict, n in trip.counts.items()),
        state="no alarm" if trip.ok else "TRUTH MISMATCH",
        passed=_passed(trip),
        labels="" if labels is None else _labels(labels),
        rows="\n".join(_row(hand) for hand in worst),
        cards="\n".join(_card(hand) for hand in worst[:PICTURES] if hand.fit is not None),
        pictured=f"The {PICTURES} worst are pictured. " if len(worst) > PICTURES else "",
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page, encoding="utf-8")


def _passed(trip: RoundTrip) -> str:
    means = trip.to_json()["passed"]
    if not means:
        return "No hand passed."
    return (
        f"Hands that passed, on average: vertices {means['v2v_mean_mm']:.2f} mm from the truth, "
        f"those near a point {means['v2v_seen_mean_mm']:.2f} mm, their surface "
        f"{means['surface_seen_mm']:.2f} mm; the sensor explains {means['floor_mm']:.2f} mm."
    )


def _labels(report: VerifyReport) -> str:
    """Say what the label checks found, and what they could not judge."""
    found = f"{len(report.failures)} failures" if report.failures else "ok"
    lines = [f"<p><b>Labels: {found}</b>, {report.views} views of {report.samples} samples.</p>"]
    told = [f"sample {f.sample}, view {f.view}: {f.check}: {f.message} ({f.value:.4g}, at most "
            f"{f.limit:.4g})" for f in report.failures[:PICTURES]]  # fmt: skip
    told += [f"not judged: {check}, {times} of {times + report.judged[check]}: {reason}"
             for check, reasons in report.reasons().items()
             for reason, times in reasons.items()]  # fmt: skip
    items = "".join(f"<li>{html.escape(line)}</li>" for line in told)
    return "".join([*lines, f"<ul>{items}</ul>" if told else ""])


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
    """Pictures of a fit and, where it did not pass, of the truth in its place.

    Both are drawn smooth through their vertices, as the generator draws them: off flat triangles
    even the truth would look wrong by half a millimetre.
    """
    assert hand.fit is not None
    points = np.zeros((0, 3)) if hand.points is None else hand.points
    title = f"sample {hand.sample}, hand {hand.hand_number}: {hand.verdict} {hand.reason}"
    faces, seen_like = hand.fit.model.faces, hand.fit.vertices
    shown = []
    if hand.fit.reason != "no_points":
        shown.append(_picture(points, hand.fit.vertices, faces, "as fitted", seen_like))
    if hand.verdict != "pass" and hand.truth is not None:
        far = np.linalg.norm(seen_like.mean(axis=0) - hand.truth.mean(axis=0)) > FAR_M
        sides = hand.truth if far else seen_like
        shown.append(_picture(points, hand.truth, faces, "as it truly was", sides))
    told = html.escape(str(hand.fit.report.get("message") or ""))
    caption = f"<figcaption><b>{html.escape(title.strip())}</b> {told}</figcaption>"
    return f"<figure>{caption}<div>{''.join(shown)}</div></figure>"


def _picture(
    points: Array, vertices: Array, faces: NDArray[Any], what: str, seen_like: Array
) -> str:
    smooth = InterpolatingSubdivision.build(faces, len(vertices), LEVELS)
    picture = draw_overlay(points, smooth.apply(vertices), smooth.faces, seen_like=seen_like)
    data = cv2.imencode(".jpg", np.ascontiguousarray(picture[..., ::-1]),
                        [cv2.IMWRITE_JPEG_QUALITY, 80])[1]  # fmt: skip
    text = base64.b64encode(data.tobytes()).decode()
    return f'<span>{what}<img alt="{what}" src="data:image/jpeg;base64,{text}"></span>'


_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}: round trip</title>
<style>
body {{ font: 15px/1.4 system-ui, sans-serif; margin: 2em auto; max-width: 1200px; padding: 0 1em;
  color: #222; background: #fff }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums }}
td, th {{ padding: .2em .6em; text-align: right; border-bottom: 1px solid #ddd }}
td:nth-child(-n+5), th:nth-child(-n+5) {{ text-align: left }}
tr.truth_mismatch {{ background: #fdd }} tr.fail {{ background: #ffe9d0 }}
tr.unobserved {{ background: #fffbd6 }}
td:nth-child(4) {{ min-width: 13em }} figure {{ margin: 2em 0 0 }}
figure div {{ display: flex; gap: 1em }} span {{ width: 49%; color: #555 }} img {{ width: 100% }}
dt {{ float: left; clear: left; width: 9em; font-weight: bold }} dd {{ margin-left: 9.5em }}
</style>
<h1>{title}: round trip from {start}</h1>
<p><b>Round trip: {state}</b>, {counts}. {passed}</p>
{labels}
<dl><dt>pass<dd>the fit explains the points and lies at the truth
<dt>unobserved<dd>the points do not determine the parts in brackets; counted, not failed
<dt>fail<dd>the fitter's failure: the reason says which, and how a fit from the truth ends
<dt>truth_mismatch<dd>the alarm: the fit is good and the truth is far, or the stored points do not
lie on the true surface
<dt>v2v<dd>mean distance of fitted from true vertices; seen: of those within 2.5 mm of a point
<dt>coverage<dd>share of the true vertices within 2.5 mm of a point
<dt>truth explains<dd>share of the points, less the sensor's error, on the true surface
<dt>x floor<dd>error of the seen vertices over what noise and sensor explain</dl>
<table><thead><tr><th>sample<th>hand<th>verdict<th>reason<th>source<th>v2v mm<th>v2v seen mm
<th>surface seen mm<th>joints mm<th>rotation deg<th>coverage<th>truth explains
<th>x floor</tr></thead>
<tbody>
{rows}
</tbody></table>
<p>{pictured}Left to right in each picture: the stored points; points over the surface; the surface
coloured by their distance (green 0, red 1 mm and more, grey not seen). What did not pass is shown
twice, from the same sides if they are near one another.</p>
{cards}
</html>
"""
