"""Feet that give way where they touch the ground (SUPR, Eq. 6): contact, network, deformation.

The network sees a foot's pose (13 quaternions minus identity), its first two shape coefficients
and which of its 266 points touch; it returns a rest-pose offset per point. Input 320, layers
256-128-64-32-16-32-64-128-798, leaky ReLU 0.1 between them (not after the last). A foot that
touches nothing is not deformed.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from synthgen.errors import ModelError, ShapeError
from synthgen.models.pose_features import quaternion_feature
from synthgen.models.shipped import shipped_extras

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

CONTACT_M = 1e-4
SLOPE = 0.1
N_POINTS = 266
SIZES = (320, 256, 128, 64, 32, 16, 32, 64, 128, 3 * N_POINTS)


@dataclass(frozen=True, eq=False)
class FootNetwork:
    """One foot's deformation network and where it sits on the body.

    Attributes
    ----------
    side : {"left", "right"}
    joint_ids : (13,) int64
        Knee, ankle, ball and ten toe joints in the body's tree.
    vertex_ids : (n,) int64
        The foot's vertices in the body.
    point_ids : (266,) int64
        Body vertices whose contact is the input and whose offset is the output.
    spread : sparse (n, 266)
        Carries the points' offsets to all of the foot's vertices.
    shape_basis : (2, nb)
        The foot's first two shape coefficients from the body's betas.
    matrices, biases : tuples of (out, in) and (out,)
        Of the nine layers; the output is in metres.
    """

    side: Literal["left", "right"]
    joint_ids: Ints
    vertex_ids: Ints
    point_ids: Ints
    spread: sparse.csr_matrix
    shape_basis: Array
    matrices: tuple[Array, ...]
    biases: tuple[Array, ...]

    def feature(self, shape: NDArray[Any], pose: NDArray[Any], contact: NDArray[Any]) -> Array:
        """Return the network's input (B, 320).

        Parameters
        ----------
        shape : (B, nb) float
        pose : (B, K, 3) float
            The body's, axis-angle.
        contact : (B, 266) bool
        """
        turns = np.asarray(pose, dtype=np.float64)[:, self.joint_ids]
        quaternions = quaternion_feature(turns).reshape(len(turns), -1)
        betas = np.asarray(shape, dtype=np.float64)
        own = betas @ self.shape_basis[:, : betas.shape[1]].T
        return np.concatenate([quaternions, own, np.asarray(contact, np.float64)], axis=1)

    def forward(self, feature: NDArray[Any]) -> Array:
        """Return the points' rest-pose offsets (B, 266, 3), metres, of inputs (B, 320).

        Raises
        ------
        ShapeError
            If the input has another width.
        """
        x = np.asarray(feature, dtype=np.float64)
        if x.ndim != 2 or x.shape[1] != SIZES[0]:
            raise ShapeError(f"foot feature is {x.shape}; expected (B, {SIZES[0]})")
        for k, (matrix, bias) in enumerate(zip(self.matrices, self.biases, strict=True)):
            x = x @ matrix.T + bias
            if k + 1 < len(self.matrices):
                x = np.where(x > 0, x, SLOPE * x)
        return x.reshape(len(x), N_POINTS, 3)

    def offsets(self, shape: NDArray[Any], pose: NDArray[Any], contact: NDArray[Any]) -> Array:
        """Return rest-pose offsets (B, n, 3) of the foot's vertices, zero where nothing touches.

        Arguments as :meth:`feature`.
        """
        touched = np.asarray(contact, dtype=bool)
        points = self.forward(self.feature(shape, pose, touched))
        points[~touched.any(axis=1)] = 0
        return np.stack([self.spread @ p for p in points])


def touching(
    points: NDArray[Any], plane: Sequence[float] = (0.0, 1.0, 0.0, 0.0)
) -> NDArray[np.bool_]:
    """Tell which points (..., 3) are on or below the ground, within 0.1 mm.

    Parameters
    ----------
    points : (..., 3) float, metres
    plane : (a, b, c, d)
        Ground where ``a x + b y + c z = d``; (a, b, c) is unit and points up.
    """
    a = np.asarray(plane, dtype=np.float64)
    return np.asarray(np.asarray(points, dtype=np.float64) @ a[:3] - a[3] <= CONTACT_M)


def deform_feet(
    networks: Sequence[FootNetwork],
    vertices: NDArray[Any],
    transforms: NDArray[Any],
    weights: NDArray[Any],
    shape: NDArray[Any],
    pose: NDArray[Any],
    plane: Sequence[float] = (0.0, 1.0, 0.0, 0.0),
) -> NDArray[np.float32]:
    """Press the feet of posed bodies flat where they go through the ground.

    Parameters
    ----------
    networks : sequence of FootNetwork
    vertices : (B, V, 3) float
        Posed body, translation included, metres.
    transforms : (B, K, 4, 4) float
        Of the posed joints.
    weights : (V, K) float
        The body's skinning weights.
    shape, pose, plane
        As :meth:`FootNetwork.feature` and :func:`touching`.

    Returns
    -------
    (B, V, 3) float32
        All but the feet unchanged: offsets before skinning only turn with the blended joints.
    """
    result = np.array(vertices, dtype=np.float32)
    turns = np.asarray(transforms, dtype=np.float64)[..., :3, :3]
    for network in networks:
        ids = network.vertex_ids
        contact = touching(result[:, network.point_ids], plane)
        offsets = network.offsets(shape, pose, contact)
        blended = np.einsum("vk,bkij->bvij", np.asarray(weights)[ids], turns)
        result[:, ids] += (blended @ offsets[..., None])[..., 0].astype(np.float32)
    return result


def feet_of(model: BodyModel) -> tuple[FootNetwork, FootNetwork]:
    """Return the left and the right foot's network of a shipped model.

    Raises
    ------
    ModelError
        If it has none, or they do not fit the body.
    """
    feet = read_feet(shipped_extras(model.name))
    for foot in feet:
        limits = (foot.joint_ids, len(model.parents)), (foot.vertex_ids, len(model.v_template))
        for ids, n in (*limits, (foot.point_ids, len(model.v_template))):
            if not 0 <= ids.min(initial=0) <= ids.max(initial=0) < n:
                raise ModelError(f"the {foot.side} foot's network names {ids.max()} of {n}")
    return feet


def read_feet(arrays: Mapping[str, Any]) -> tuple[FootNetwork, FootNetwork]:
    """Read the left and the right foot's network of a shipped model.

    The right foot's weights are stored; the left foot's network is its mirror image: inputs
    (x, -y, -z, w), outputs (-x, y, z).

    Raises
    ------
    ModelError
        If the model has none, or a part of them is missing or does not fit.
    """
    if "foot_matrix_0" not in arrays:
        raise ModelError("this model has no foot networks (foot_matrix_0); cc0-supr has")
    try:
        return _both(arrays)
    except KeyError as error:
        raise ModelError(f"the foot networks lack {error.args[0]!r}") from None
    except (ValueError, IndexError, TypeError) as error:
        raise ModelError(f"the foot networks do not fit together ({error})") from None


def _both(arrays: Mapping[str, Any]) -> tuple[FootNetwork, FootNetwork]:
    matrices = [np.asarray(arrays[f"foot_matrix_{k}"], np.float64) for k in range(len(SIZES) - 1)]
    biases = [np.asarray(arrays[f"foot_bias_{k}"], np.float64) for k in range(len(SIZES) - 1)]
    found = [tuple(m.shape) for m in matrices]
    wanted = [(b, a) for a, b in itertools.pairwise(SIZES)]
    if found != wanted:
        raise ModelError(f"foot_matrix_* are {found}; expected {wanted}")
    if [b.shape for b in biases] != [(n,) for n in SIZES[1:]]:
        raise ModelError(f"foot_bias_* are {[b.shape for b in biases]}; expected {SIZES[1:]}")
    sign_in = np.ones(SIZES[0])
    sign_in[:52] = np.tile([1, -1, -1, 1], 13)
    sign_out = np.tile([-1.0, 1.0, 1.0], N_POINTS)
    left = ([matrices[0] * sign_in, *matrices[1:-1], matrices[-1] * sign_out[:, None]],
            [*biases[:-1], biases[-1] * sign_out])  # fmt: skip
    return (
        _foot(arrays, "left", *left),
        _foot(arrays, "right", matrices, biases),
    )


def _foot(
    arrays: Mapping[str, Any], side: Literal["left", "right"], matrices: list[Array],
    biases: list[Array],
) -> FootNetwork:  # fmt: skip
    vertex_ids = np.asarray(arrays[f"foot_{side}_vertex_ids"], dtype=np.int64)
    where = (np.asarray(arrays["foot_spread_row"]), np.asarray(arrays["foot_spread_column"]))
    share = np.asarray(arrays["foot_spread_value"], dtype=np.float64)
    return FootNetwork(
        side=side,
        joint_ids=np.asarray(arrays[f"foot_{side}_joint_ids"], dtype=np.int64),
        vertex_ids=vertex_ids,
        point_ids=np.asarray(arrays[f"foot_{side}_point_ids"], dtype=np.int64),
        spread=sparse.csr_matrix((share, where), (len(vertex_ids), N_POINTS)),
        shape_basis=np.asarray(arrays["foot_shape_basis"], dtype=np.float64),
        matrices=tuple(matrices),
        biases=tuple(biases),
    )
