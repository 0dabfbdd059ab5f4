"""What ``fit --sequence`` reads, and what it leaves behind for the same command to go on from."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile

from synthgen.cli.fit_files import names_of
from synthgen.errors import ConfigError, ShapeError

if TYPE_CHECKING:
    from synthgen.models import BodyModel
    from synthgen.registration.inspection import Expected
    from synthgen.registration.reading import StoredScan
    from synthgen.registration.tracked import Place

WHOLE, STATE = "sequence", "sequence.state"
FARTHEST_M = 1e5  # the coarse stage works in float32, and a sequence keeps its frame
FRAME_KEYS = ("scan", "verdict", "reason", "followed", "unseen_frames", "files")


@dataclass
class Reel:
    """Frames read one at a time; ``read`` are those that are not done yet."""

    paths: list[Path]
    units: str
    expected: Expected
    read: dict[int, StoredScan] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.names = names_of(self.paths, (WHOLE, STATE))
        for path in self.paths:
            if not path.is_file():
                raise ShapeError(f"{path}: no such file; name the frames in their order")

    def frames(self, first: int) -> Iterator[tuple[Any, Any]]:
        """Yield points and normals; all frames have the unit of the first that shows its own."""
        for k, path in list(enumerate(self.paths))[first:]:
            self.read[k] = scan = self._scan(k, path)
            if self.units == "auto" and scan.units:
                self.units = scan.units
            yield scan.points, scan.normals

    def _scan(self, k: int, path: Path) -> StoredScan:
        """Read a frame; a later one that cannot be read is an empty one."""
        import numpy as np

        from synthgen.registration.far import origin_of
        from synthgen.registration.reading import StoredScan, read_scan

        try:
            scan = read_scan(path, self.units, self.expected)
            middle = origin_of(scan.points)
            if middle is not None and np.linalg.norm(middle) > FARTHEST_M:
                raise ConfigError(
                    f"{path}: lies {np.linalg.norm(middle):.3g} m from the origin; --sequence "
                    f"tracks within {FARTHEST_M:g} m: subtract an offset from all frames, or fit "
                    "them one by one"
                )
            return scan
        except ShapeError as error:
            if k == 0:
                raise
            return StoredScan(np.zeros((0, 3)), None, "", str(error))


def key_of(scans: list[Path], digest: str, hand: str, start: Any, *options: Any) -> str:
    """Return a name of all that decides a sequence's results."""
    import numpy as np

    files = [(str(p.resolve()), p.stat().st_size, p.stat().st_mtime_ns) for p in scans]
    begin = start if isinstance(start, str) else [np.asarray(part).tolist() for part in start]
    told = json.dumps([files, digest, hand, begin, *options])
    return hashlib.sha256(told.encode()).hexdigest()


@dataclass
class Log:
    """The reports of the frames that are done, and where the sequence stands after them."""

    out: Path
    reel: Reel
    key: str
    reports: list[dict[str, Any]] = field(default_factory=list)
    place: Place | None = None

    @property
    def state(self) -> Path:
        """File in which the sequence's place is kept until it is whole."""
        return self.out / f"{STATE}.npz"

    def paused(self, place: Place) -> None:
        """Keep the place after a frame whose files are written."""
        import numpy as np

        from synthgen.corpus.atomic import replace

        self.place = place
        rest = {"key": self.key, "frames": len(self.reports), "units": self.reel.units,
                "unseen": dict(place.unseen), "freeze": place.freeze, "cold": place.cold,
                "hand": place.hand}  # fmt: skip
        arrays: dict[str, Any] = {
            "motion": place.motion, "told": np.array(json.dumps(rest)), "x": place.x,
            "betas": place.betas, "offset": place.offset,
        }  # fmt: skip
        file = io.BytesIO()
        np.savez(file, **{k: v for k, v in arrays.items() if v is not None})
        replace(self.state, file.getvalue())

    def recalled(self) -> Place | None:
        """Return where the same command stopped, its reports being there; None: begin."""
        import numpy as np

        from synthgen.registration.tracked import Place

        try:
            with np.load(self.state, allow_pickle=False) as stored:
                told = json.loads(str(stored["told"]))
                arrays = {k: stored[k] if k in stored else None for k in ("x", "betas", "offset")}
                motion = stored["motion"]
            if told["key"] != self.key:
                return None
            reports = [json.loads((self.out / f"{name}.json").read_text(encoding="utf-8"))
                       for name in self.reel.names[: told["frames"]]]  # fmt: skip
        except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile):
            return None
        self.reports, self.reel.units = reports, told["units"]
        self.place = Place(motion=motion, unseen=told["unseen"], freeze=told["freeze"],
                           cold=told["cold"], hand=told["hand"], **arrays)  # fmt: skip
        return self.place

    def partial(self) -> Path:
        """Write what is known of a sequence that was interrupted."""
        return self._write({"complete": False, "frames": self._frames()})

    def finished(self, model: BodyModel) -> dict[str, Any]:
        """Write the whole sequence as JSON and npz, from the frames' files; return the JSON."""
        import numpy as np

        stored = [np.load(self.out / f"{name}.npz", allow_pickle=False) for name in self.reel.names]
        assert self.place is not None
        betas, offset = self.place.betas, self.place.offset
        shape = stored[-1]["shape"] if betas is None else betas
        arrays: dict[str, Any] = {
            "shape": shape, "pose": np.array([s["pose"] for s in stored]),
            "translation": np.array([s["translation"] for s in stored]),
            **{key: np.array([r[key] for r in self.reports])
               for key in ("followed", "verdict", "reason")},
        }  # fmt: skip
        if offset is not None:
            arrays["template_offset_m"] = offset
        np.savez(self.out / f"{WHOLE}.npz", **arrays)
        verdicts = [r["verdict"] for r in self.reports]
        seconds = [r["cpu_s"] for r in self.reports]
        shape_s = sum(s.get("shape", 0.0) for s in seconds)
        payload = {
            "complete": True, "model": model.name, "model_digest": model.digest,
            "own_template": offset is not None, "shape": shape.tolist(),
            "parameters": f"{WHOLE}.npz", "frames": self._frames(),
            "verdicts": {v: verdicts.count(v) for v in ("pass", "unobserved", "fail")},
            "cpu_s": {"shape": shape_s, "total": shape_s + sum(s["total"] for s in seconds)},
        }  # fmt: skip
        self._write(payload)
        self.state.unlink(missing_ok=True)
        return payload

    def _frames(self) -> list[dict[str, Any]]:
        return [{key: report.get(key) for key in FRAME_KEYS} for report in self.reports]

    def _write(self, payload: dict[str, Any]) -> Path:
        place = self.out / f"{WHOLE}.json"
        place.write_text(json.dumps(payload, indent=2) + "\n", encoding="utf-8")
        return place
