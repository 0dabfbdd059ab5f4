"""Writing the compact form that :mod:`synthgen.models.compact` reads."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# Correctives whose block stays below this are dropped, metres.
NEGLIGIBLE_M = 2e-5
_INT16 = 32767


def quantised(name: str, bases: Array) -> dict[str, Any]:
    """Pack (m, 3, n) into int16 with a scale per last index; error at most half a scale."""
    scale = np.maximum(np.abs(bases).max(axis=(0, 1)), 1e-12) / _INT16
    return {f"{name}_q": np.round(bases / scale).astype(np.int16), f"{name}_scale": scale}


def packed_expressions(name: str, bases: Array) -> dict[str, Any]:
    """Pack expression bases (V, 3, n): only the vertices that move by more than a micrometre."""
    ids = np.flatnonzero(np.abs(bases).max(axis=(1, 2)) > 1e-6)
    return {f"{name}_ids": ids.astype(np.int32), **quantised(name, bases[ids])}


def packed_weights(weights: Array, prefix: str = "") -> dict[str, Any]:
    """Pack rows of at most four weights."""
    joint = np.argsort(-weights, axis=1, kind="stable")[:, :4]
    value = np.take_along_axis(weights, joint, axis=1)
    return {
        f"{prefix}weights_joint": joint.astype(np.uint8),
        f"{prefix}weights_value": value.astype(np.float32),
    }


def packed_regressor(regressor: Array) -> dict[str, Any]:
    """Pack a sparse (K, V) regressor."""
    row, column = np.nonzero(regressor)
    return {
        "J_regressor_row": row.astype(np.uint8),
        "J_regressor_column": column.astype(np.int32),
        "J_regressor_value": regressor[row, column],
    }


def packed_correctives(blocks: Array, activation: Array | None = None) -> dict[str, Any]:
    """Pack correctives (V, K, 3, b), and the activations (V, K) of the blocks that are kept."""
    vertex, joint = np.nonzero(np.abs(blocks).max(axis=(2, 3)) > NEGLIGIBLE_M)
    kept = blocks[vertex, joint]
    scale = np.abs(kept).max() / _INT16
    result = {
        "posedirs_vertex": vertex.astype(np.uint16),
        "posedirs_joint": joint.astype(np.uint8),
        "posedirs_blocks": np.round(kept / scale).astype(np.int16),
        "posedirs_scale": np.array(scale),
    }
    if activation is not None:
        result["posedirs_activation"] = activation[vertex, joint].astype(np.float32)
    return result


def packed_uv(uv: Array) -> dict[str, Any]:
    """Pack texture coordinates in [0, 1] to 16 bits."""
    return {"uv_q": np.round(np.clip(uv, 0, 1) * 65535).astype(np.uint16)}
