"""Training of the foot network on simulated contact (SUPR, Eq. 6 and supplement 3)."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.cc0.contact import JOINTS, Foot, right_foot, simulate
from synthgen.cc0.foundation import Foundation, Progress, seeded
from synthgen.models.foot import SIZES, SLOPE, FootNetwork, read_feet

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

TRAINING, UNSEEN, EPOCHS, BATCH = 5000, 600, 70, 32
_MM = 1e3


def foot_networks(
    base: Foundation, ids: Ints, say: Progress
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Train the right foot's network (the left one mirrors it).

    Parameters
    ----------
    base : Foundation
        In SUPR form.
    ids : (n,) int64
        The right foot's vertices.
    say : callable

    Returns
    -------
    arrays : dict
        Keys ``foot_*`` that :func:`synthgen.models.foot.read_feet` reads.
    report : dict
        Mean distance, mm, to simulated feet that were not trained on: without the network and
        with it, for feet that touch; largest offset of feet that do not.
    """
    foot = right_foot(base, ids)
    say("simulating contact of feet")
    feature, offsets = simulate(foot, TRAINING, rng=seeded("feet/training"))
    say("training the foot network")
    matrices, biases = train(feature, offsets, seed=0)
    arrays = {**_packed(base, foot), **_layers(matrices, biases)}
    network = read_feet(arrays)[1]
    unseen = simulate(foot, UNSEEN, rng=seeded("feet/unseen"))
    return arrays, {"feet_unseen": {k: round(v, 5) for k, v in measure(network, *unseen).items()}}


def train(feature: Array, offsets: Array, *, seed: int) -> tuple[list[Array], list[Array]]:
    """Train the network by Adam on the mean absolute error in millimetres.

    Parameters
    ----------
    feature : (n, 320), offsets : (n, 266, 3) metres
    seed : int
        Of initial weights and batches.

    Returns
    -------
    matrices, biases : lists
        Of the nine layers, the last one's output in metres.
    """
    import torch  # only to train; what is shipped runs in NumPy

    torch.manual_seed(seed)
    torch.set_num_threads(1)
    layers: list[Any] = []
    for a, b in itertools.pairwise(SIZES):
        layers += [torch.nn.Linear(a, b), torch.nn.LeakyReLU(SLOPE)]
    network = torch.nn.Sequential(*layers[:-1])
    x = torch.tensor(feature, dtype=torch.float32)
    y = torch.tensor(_MM * offsets.reshape(len(offsets), -1), dtype=torch.float32)
    optimiser = torch.optim.Adam(network.parameters(), 1.5e-3)
    steps = EPOCHS * -(-len(x) // BATCH)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(EPOCHS):
        for batch in torch.randperm(len(x)).split(BATCH):  # type: ignore[no-untyped-call]
            loss = (network(x[batch]) - y[batch]).abs().mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            decay.step()
    linear = [layer for layer in network if isinstance(layer, torch.nn.Linear)]
    matrices = [layer.weight.detach().double().numpy() for layer in linear]
    biases = [layer.bias.detach().double().numpy() for layer in linear]
    matrices[-1], biases[-1] = matrices[-1] / _MM, biases[-1] / _MM
    return matrices, biases


def measure(network: FootNetwork, feature: Array, offsets: Array) -> dict[str, float]:
    """Distances, mm, on simulated feet: see :func:`foot_networks`."""
    contact = feature[:, -offsets.shape[1] :] > 0
    touched = contact.any(axis=1)
    predicted = network.forward(feature)
    predicted[~touched] = 0
    none = float(np.linalg.norm(offsets[touched], axis=-1).mean())
    left = float(np.linalg.norm((predicted - offsets)[touched], axis=-1).mean())
    return {
        "without_mm": _MM * none,
        "with_mm": _MM * left,
        "cut": 1 - left / none,
        "touching_points": float(contact[touched].sum(axis=1).mean()),
        "not_touching_mm": _MM * float(np.abs(predicted[~touched]).max(initial=0)),
    }


def _layers(matrices: list[Array], biases: list[Array]) -> dict[str, Any]:
    """Store layers in half precision but for the last, whose output is small."""
    kinds = [np.float16] * (len(matrices) - 1) + [np.float32]
    rows = enumerate(zip(matrices, biases, kinds, strict=True))
    result: dict[str, Any] = {}
    for k, (matrix, bias, kind) in rows:
        result[f"foot_matrix_{k}"] = matrix.astype(kind)
        result[f"foot_bias_{k}"] = bias.astype(np.float32)
    return result


def _packed(base: Foundation, foot: Foot) -> dict[str, Any]:
    row, column = np.nonzero(foot.spread)
    mirror = base.cut.mirror
    sides = {"right": foot.ids, "left": mirror[foot.ids]}
    result: dict[str, Any] = {
        "foot_spread_row": row.astype(np.int16),
        "foot_spread_column": column.astype(np.int16),
        "foot_spread_value": foot.spread[row, column].astype(np.float32),
        "foot_shape_basis": foot.basis,
    }
    for side, ids in sides.items():
        joints = [base.skeleton.index(f"{side}_{name}") for name in JOINTS]
        result[f"foot_{side}_joint_ids"] = np.array(joints, dtype=np.uint8)
        result[f"foot_{side}_vertex_ids"] = ids.astype(np.uint16)
        result[f"foot_{side}_point_ids"] = ids[foot.chosen].astype(np.uint16)
    return result
