"""The compact form in which ``cc0-body`` and ``cc0-supr`` are shipped, and its decoding.

Bases are 16-bit integers with a scale per component, correctives blocks of a vertex and a joint,
weights four per vertex, regressors triplets. :func:`expand` returns the arrays of the families'
own files (``SMPLH_*.npz``, ``supr_*.npy``) under their names, and passes everything else through.

Keys of the compact form
------------------------
``shipped_form`` "smplh" or "supr"; ``X_q`` (..., n) int16 and ``X_scale`` (n,) for X in
``shapedirs`` (V, 3, n); ``exprdirs_ids`` (m,) rows of ``exprdirs_q`` (m, 3, n), all others zero;
``posedirs_vertex``, ``posedirs_joint`` (N,), ``posedirs_blocks`` (N, 3, b) int16 and
``posedirs_scale``: b is 9 (row-major R - I) or 4 (quaternion x y z, w - 1);
``posedirs_activation`` (N,) of the SUPR form; ``weights_joint``, ``weights_value`` (V, 4);
``J_regressor_row``, ``_column``, ``_value`` of the (K, V) regressor; ``hands_mean``,
``hands_components``, ``hands_coeffs`` of the right hand; ``attachments`` names of separate meshes,
each with ``NAME_template``, ``NAME_f``, ``NAME_colour`` (one per face) and either own bases and
weights in the same forms or ``NAME_bind_ids``, ``NAME_bind_weights`` (n, 3): the body's vertices
whose mean it follows.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from synthgen.errors import ModelError
from synthgen.models.pickles import MAX_BYTES

Array = NDArray[np.float64]
Arrays = dict[str, Any]
_TURN = np.array([1.0, -1.0, -1.0])


def is_shipped(arrays: Arrays) -> bool:
    """Tell whether arrays are in the compact form."""
    return "shipped_form" in arrays


def expand(arrays: Arrays) -> Arrays:
    """Decode either compact form into the arrays of its family's files.

    Raises
    ------
    ModelError
        If the form is unknown or a key is missing.
    """
    form = str(arrays.get("shipped_form"))
    decoders = {"smplh": expand_smplh, "supr": expand_supr}
    if form not in decoders:
        raise ModelError(f"shipped_form is {form!r}; known are {sorted(decoders)}")
    try:
        _check_size(arrays)
        return decoders[form](arrays)
    except KeyError as error:
        raise ModelError(f"no {error.args[0]!r} in a model of shipped form {form!r}") from None


def _check_size(arrays: Arrays) -> None:
    """Refuse a compact form whose dense one would fill memory: it need not be large itself."""
    v, k = len(arrays["v_template"]), arrays["kintree_table"].shape[1]
    features = k * arrays["posedirs_blocks"].shape[2]
    components = arrays["exprdirs_q"].shape[-1] if "exprdirs_q" in arrays else 0
    wanted = 4 * 3 * v * (features + components + 3 * k)  # float32, regressor and weights too
    if wanted > MAX_BYTES:
        raise ModelError(
            f"{v} vertices and {k} joints would take {wanted} bytes; a model has at most "
            f"{MAX_BYTES}"
        )


def expand_smplh(arrays: Arrays) -> Arrays:
    """Decode the SMPL+H form: ``posedirs`` (V, 3, 9 (K - 1)), ``J_regressor`` (K, V)."""
    result = _expand_common(arrays)
    dense = _posedirs(arrays)
    result["posedirs"] = dense[:, :, 9:]  # the root has no correctives in this family
    result["J_regressor"] = regressor(arrays).toarray()
    result |= _hands(arrays)
    result |= {"bs_style": np.array("lbs"), "bs_type": np.array("lrotmin")}
    return result


def expand_supr(arrays: Arrays) -> Arrays:
    """Decode the SUPR form: ``posedirs`` (V, 3, 4 K), affine ``J_regressor`` (3 K, 3 V + 1)."""
    result = _expand_common(arrays)
    result["posedirs"] = _posedirs(arrays)
    result["J_regressor"] = affine_regressor(regressor(arrays)).astype(np.float32).toarray()
    result["activations"] = activations(arrays)
    result |= _hands(arrays)
    return result


def regressor(arrays: Arrays) -> sparse.csr_matrix:
    """Return the sparse joint regressor (K, V), rows summing to 1."""
    shape = (arrays["kintree_table"].shape[1], len(arrays["v_template"]))
    value = np.asarray(arrays["J_regressor_value"], dtype=np.float64)
    where = (arrays["J_regressor_row"], arrays["J_regressor_column"])
    return sparse.csr_matrix((value, where), shape)


def affine_regressor(plain: sparse.csr_matrix) -> sparse.csr_matrix:
    """Write a (K, V) regressor as the (3 K, 3 V + 1) one of SUPR's files, offsets zero."""
    spread = sparse.kron(plain, sparse.eye_array(3), format="csr")
    return sparse.csr_matrix(sparse.hstack([spread, sparse.csr_matrix((spread.shape[0], 1))]))


def activations(arrays: Arrays) -> NDArray[np.float32]:
    """Return the activations A (K, V) of Eq. 3 of SUPR, metres; zero where a joint has no say."""
    result = np.zeros((arrays["kintree_table"].shape[1], len(arrays["v_template"])), np.float32)
    result[arrays["posedirs_joint"], arrays["posedirs_vertex"]] = arrays["posedirs_activation"]
    return result


def dequantised(arrays: Arrays, name: str) -> NDArray[np.float32]:
    """Return ``name`` (m, 3, n) from its integers and scales."""
    return scaled(arrays[f"{name}_q"], arrays[f"{name}_scale"]).astype(np.float32)


def scaled(integers: NDArray[Any], scale: NDArray[Any]) -> Array:
    """Return integers times a scale that broadcasts to their shape, never beyond it.

    Raises
    ------
    ValueError
        If the scale does not fit: a file could ask for gigabytes.
    """
    return integers * np.broadcast_to(np.asarray(scale, np.float64), integers.shape)


def skinning_weights(arrays: Arrays, prefix: str = "") -> Array:
    """Return dense weights (V, K), rows summing to 1."""
    joint = np.asarray(arrays[f"{prefix}weights_joint"], dtype=np.int64)
    value = np.asarray(arrays[f"{prefix}weights_value"], dtype=np.float64)
    result = np.zeros((len(joint), arrays["kintree_table"].shape[1]))
    np.add.at(result, (np.arange(len(joint))[:, None], joint), value)
    return np.asarray(result / result.sum(axis=1, keepdims=True))


def corrective_blocks(arrays: Arrays) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Return vertex (N,), joint (N,) and blocks (N, 3, b) of the pose correctives, metres."""
    blocks = arrays["posedirs_blocks"] * float(arrays["posedirs_scale"])
    vertex, joint = (np.asarray(arrays[f"posedirs_{k}"], np.int64) for k in ("vertex", "joint"))
    return vertex, joint, np.asarray(blocks, dtype=np.float64)


def _expand_common(arrays: Arrays) -> Arrays:
    packed = ("shapedirs_", "exprdirs_", "weights_", "posedirs_", "J_regressor_")
    result = {k: v for k, v in arrays.items() if not k.startswith(packed)}
    result["shapedirs"] = dequantised(arrays, "shapedirs")
    result["weights"] = skinning_weights(arrays)
    if "exprdirs_q" in arrays:
        result["exprdirs"] = expressions(arrays)
    if "uv_q" in arrays:
        result["uv"] = result.pop("uv_q").astype(np.float64) / 65535
    return result


def expressions(arrays: Arrays) -> NDArray[np.float32]:
    """Return ``exprdirs`` (V, 3, ne), metres per standard deviation."""
    moved = dequantised(arrays, "exprdirs")
    result = np.zeros((len(arrays["v_template"]), *moved.shape[1:]), np.float32)
    result[arrays["exprdirs_ids"]] = moved
    return result


def _posedirs(arrays: Arrays) -> NDArray[np.float32]:
    vertex, joint, blocks = corrective_blocks(arrays)
    n, k, b = len(arrays["v_template"]), arrays["kintree_table"].shape[1], blocks.shape[2]
    dense = np.zeros((n, 3, k, b), np.float32)
    dense[vertex, :, joint] = blocks
    return dense.reshape(n, 3, k * b)


def _hands(arrays: Arrays) -> Arrays:
    """Both hands' pose spaces; the left one mirrors the right one (A.5)."""
    turn = np.tile(_TURN, 15)
    right = {k: np.asarray(arrays[f"hands_{k}"], np.float64) for k in ("mean", "components")}
    result: Arrays = {}
    for key, value in right.items():
        result[f"hands_{key}r"], result[f"hands_{key}l"] = value, value * turn
    result["hands_coeffsr"] = result["hands_coeffsl"] = np.asarray(arrays["hands_coeffs"])
    return result
