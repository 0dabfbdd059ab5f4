"""Random files in the exact form of published MANO models, chumpy and scipy objects included."""

from __future__ import annotations

import pickle
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from synthgen.models.joints import MANO16_PARENTS
from synthgen.sampling.streams import stream


def arrays(seed: int = 0) -> dict[str, Any]:
    """A tube with random bases: one open ring at the wrist, a tip on the far end."""
    rng = stream(seed, "sample", 0, 0, "mano file")
    rings, around = 24, 10
    x = np.linspace(0.0, -0.18, rings)
    angle = 2 * np.pi * np.arange(around) / around
    ring = np.stack([0 * angle, np.cos(angle), np.sin(angle)], axis=1) * 0.02
    v = (x[:, None, None] * [1.0, 0, 0] + ring).reshape(-1, 3)
    ids = np.arange(rings * around).reshape(rings, around)
    a, b = ids, np.roll(ids, -1, axis=1)
    side = np.concatenate([np.stack([a[:-1], a[1:], b[:-1]], -1).reshape(-1, 3),
                           np.stack([b[:-1], a[1:], b[1:]], -1).reshape(-1, 3)])  # fmt: skip
    tip = np.stack([np.full(around, len(v)), b[-1], a[-1]], axis=1)
    v = np.vstack([v, [-0.19, 0, 0]])
    regressor = np.zeros((16, len(v)))
    weights = np.zeros((len(v), 16))
    for k in range(16):
        regressor[k, ids[min(k, rings - 1)]] = 1 / around
    owner = np.minimum((np.arange(len(v)) // around) * 16 // rings, 15)
    weights[np.arange(len(v)), owner] = 0.75
    weights[np.arange(len(v)), np.maximum(owner - 1, 0)] += 0.25
    table = np.stack([np.array(MANO16_PARENTS), np.arange(16)]).astype(np.int64)
    table[0, 0] = 4294967295
    return {
        "v_template": v,
        "shapedirs": rng.normal(0, 1e-3, (len(v), 3, 10)),
        "posedirs": rng.normal(0, 1e-4, (len(v), 3, 135)),
        "weights": weights,
        "J_regressor": regressor,
        "kintree_table": table,
        "f": np.concatenate([side, tip]).astype(np.uint32),
        "hands_mean": rng.normal(0, 0.2, 45),
        "hands_components": np.linalg.qr(rng.normal(size=(45, 45)))[0],
        "hands_coeffs": rng.normal(0, 0.3, (80, 45)),
        "bs_style": "lbs",
        "bs_type": "lrotmin",
    }


def _module(name: str, **members: Any) -> types.ModuleType:
    module = types.ModuleType(name)
    for key, value in members.items():
        setattr(module, key, value)
        value.__module__ = name
    return module


def write_pickle(path: Path, content: dict[str, Any], protocol: int = 2) -> None:
    """Write as published: chumpy ``Select`` shape bases, an old scipy ``csc`` regressor."""

    class Ch:
        def __init__(self, x: Any) -> None:
            self.x = x

    class Select:
        def __init__(self, a: Any, idxs: Any, shape: Any) -> None:
            self.a, self.idxs, self.preferred_shape = a, idxs, shape

    class csc_matrix:  # noqa: N801
        def __init__(self, m: Any) -> None:
            self._shape, self.data, self.indices, self.indptr = m.shape, m.data, m.indices, m.indptr

    for cls in (Ch, Select, csc_matrix):
        cls.__qualname__ = cls.__name__
    fake = {
        "chumpy": _module("chumpy"),
        "chumpy.ch": _module("chumpy.ch", Ch=Ch),
        "chumpy.reordering": _module("chumpy.reordering", Select=Select),
        "scipy.sparse.csc": _module("scipy.sparse.csc", csc_matrix=csc_matrix),
    }
    before = {name: sys.modules.get(name) for name in fake}
    sys.modules.update(fake)
    try:
        shapes = content["shapedirs"]
        stored = dict(content)
        stored["shapedirs"] = Select(Ch(shapes.copy()), np.arange(shapes.size), shapes.shape)
        stored["J_regressor"] = csc_matrix(sparse.csc_matrix(content["J_regressor"]))
        path.write_bytes(pickle.dumps(stored, protocol=protocol))  # noqa: TID251
    finally:
        for name, module in before.items():
            if module is None:
                sys.modules.pop(name, None)
            else:
                sys.modules[name] = module
