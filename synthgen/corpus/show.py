"""Everything about one sample; and the proof that it can be made again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from synthgen.config import Config, load_config
from synthgen.corpus import atomic
from synthgen.corpus.checksums import CONFIG
from synthgen.corpus.columns import encode_view, key_of
from synthgen.corpus.gallery import depth_picture, parts_picture, skeleton_picture
from synthgen.corpus.manifest import rig_digests
from synthgen.corpus.reading import Corpus, open_corpus
from synthgen.corpus.runner import with_sensors
from synthgen.corpus.sample import Sample
from synthgen.corpus.scan_pictures import scan_pictures
from synthgen.errors import CorpusError
from synthgen.scanner import Scan


def describe(
    path: str | Path, index: int, *, remake: bool = False, out: Path | None = None
) -> dict[str, Any]:
    """Describe a sample and write its pictures.

    Parameters
    ----------
    path : str or Path
        A finished corpus.
    index : int
        Position in the corpus.
    remake : bool
        Render it again and compare every member byte for byte.
    out : Path, optional
        Folder of the pictures; ``show`` in the corpus by default.

    Returns
    -------
    dict
        JSON types; ``remake`` holds ``same`` and the names of members that differ.
    """
    corpus = open_corpus(path)
    sample = corpus[index]
    spec = sample.spec
    folder = corpus.path / "show" if out is None else out
    atomic.make_folder(folder)
    found: dict[str, Any] = {
        "sample": sample.index,
        "attempt": spec.attempt,
        "factors": spec.factors,
        "subjects": [
            {"hand": s.hand, "model": s.model, "shape": s.shape.round(4).tolist(),
             "pose": s.pose.round(5).tolist(), "translation_m": s.translation.round(5).tolist(),
             "joints_m": s.joints.astype(np.float64).round(5).tolist()} for s in sample.subjects
        ],
        "views": [
            {"key": v.key, "K": v.camera.K.tolist(),
             "keypoints_state": [h.keypoints_state.tolist() for h in v.hands]}
            for v in sample.views
        ],
        "pictures": [str(_pictures(folder, sample, k)) for k in range(len(sample.views))],
    }  # fmt: skip
    if sample.scan is not None:
        found["scan"] = _scan(sample.scan)
        found["pictures"] += [str(path) for path in _scan_pictures(folder, sample, sample.scan)]
    if remake:
        # As the runner does: sums over several threads round otherwise.
        with threadpool_limits(limits=1):
            found["remake"] = compare(corpus, sample)
    return found


def _pictures(folder: Path, sample: Sample, number: int) -> Path:
    """Write one view's picture, skeleton, parts and depths side by side as a PNG."""
    view = sample.views[number]
    row: list[NDArray[np.uint8]] = [view.image, skeleton_picture(view), parts_picture(view)]
    if "depth" in view.columns:
        row.append(depth_picture(view))
    if view.sensor_depth_z_m is not None:
        row.append(depth_picture(view, view.sensor_depth_z_m))
    sheet = np.concatenate(row, axis=1)[..., ::-1]
    path = folder / f"{view.key}.png"
    atomic.replace(path, cv2.imencode(".png", sheet)[1].tobytes())
    return path


def _scan(scan: Scan) -> dict[str, Any]:
    """Return how large and how wrong a scan is, JSON types."""
    error = scan.provenance["error_m"].astype(np.float64)
    return {
        "level": scan.level,
        "vertices": len(scan.vertices),
        "faces": len(scan.faces),
        "rms_m": float(np.sqrt(np.mean(error**2))),
        "median_m": float(np.median(error)),
        "coloured": float((scan.provenance["colour_unit"] >= 0).mean()),
        "notes": scan.report.get("notes", []),
        "units": scan.report.get("units", {}),
    }


def _scan_pictures(folder: Path, sample: Sample, scan: Scan) -> list[Path]:
    paths = []
    for name, picture in scan_pictures(scan).items():
        path = folder / f"{sample.views[0].key}.{name}.png"
        atomic.replace(path, cv2.imencode(".png", picture[..., ::-1])[1].tobytes())
        paths.append(path)
    return paths


def compare(corpus: Corpus, sample: Sample) -> dict[str, Any]:
    """Render a sample again from its spec; tell which stored members differ.

    Returns
    -------
    dict
        ``same``, and the names of the members ``differing``; where the sample is rejected this
        time, the ``reason``.

    Raises
    ------
    CorpusError
        If a rig is no longer what the corpus was made with.
    """
    from synthgen.render.renderer import Renderer

    config = load_config(str(corpus.path / CONFIG))
    _same_rigs(corpus, config)
    renderer = Renderer(corpus.manifest["variant"])
    differing = []
    rendered = renderer.render(sample.spec)
    reason, views = with_sensors(config, lambda _: (None, rendered))(sample.spec)
    if reason is not None:
        return {"same": False, "differing": [], "reason": reason}
    for number, view in enumerate(views):
        encoded = encode_view(
            sample.spec, number, view, config.corpus.columns, config.corpus.jpeg_quality
        )
        key = key_of(sample.index, number)
        for column, members in encoded.items():
            for suffix, data in members.items():
                if sample.views[number].stored(column, suffix) != data:
                    differing.append(f"{column}/{key}.{suffix}")
    return {"same": not differing, "differing": differing}


def _same_rigs(corpus: Corpus, config: Config) -> None:
    for name, digest in rig_digests(config).items():
        made = str(corpus.manifest.get(name, digest))  # older corpora do not say
        if made != digest:
            raise CorpusError(
                f"{name} was {made[:12]}, is {digest[:12]}: the rig has changed since "
                f"{corpus.path} was made (scanner.rig is {config.scanner.rig}); restore its file"
            )
