"""Training the initialiser of a hand model, from the engine's own samplers, in CPU minutes.

DeepSets / PointNet with K hypotheses, winner takes all (Guzman-Rivera 2012): the loss is the mean
distance of 21 keypoints, by differentiable forward kinematics, of the best hypothesis.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import nn

from synthgen.errors import ModelError
from synthgen.models import BodyModel, mirror_model
from synthgen.models.mano import ManoModel
from synthgen.models.packed import fold_joints
from synthgen.registration.bank import Bank, make_bank
from synthgen.registration.initialiser import HYPOTHESES, LAYERS, POSE_OUT, SCALE_M, Initialiser
from synthgen.registration.prior import HandPrior, learn_prior
from synthgen.sampling.streams import stream

BATCH, WARM_UP, RATE, HELD_OUT = 64, 100, 3e-3, 300


@dataclass(frozen=True)
class Trained:
    """An initialiser and how it was made.

    Attributes
    ----------
    initialiser : Initialiser
    steps : int
    error_m : dict
        Held-out mean keypoint error of the best hypothesis, quantiles, metres.
    """

    initialiser: Initialiser
    steps: int
    error_m: dict[str, float]


def _block(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, outputs, bias=False), nn.BatchNorm1d(outputs), nn.ReLU())


class Net(nn.Module):
    """The network of :class:`synthgen.registration.initialiser.Initialiser`, trainable."""

    def __init__(self) -> None:
        super().__init__()
        self.point1, self.point2 = _block(6, 64), _block(64, 128)
        self.joint1, self.joint2 = _block(256, 128), _block(128, 256)
        self.head1, self.head2 = _block(512, 384), _block(384, 256)
        self.out = nn.Linear(256, HYPOTHESES * (10 + POSE_OUT))
        with torch.no_grad():
            self.out.weight *= 0.3

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """(B, N, 6) -> (B, K, 25)."""
        b, n, _ = x.shape
        y = self.point2(self.point1(x.reshape(b * n, 6)))
        most = y.reshape(b, n, -1).amax(1)
        y = torch.cat([y, most[:, None].expand(-1, n, -1).reshape(b * n, -1)], 1)
        y = self.joint2(self.joint1(y)).reshape(b, n, -1)
        hidden = self.head2(self.head1(torch.cat([y.amax(1), y.mean(1)], 1)))
        out: torch.Tensor = self.out(hidden).reshape(b, HYPOTHESES, -1)
        return out


class Skeleton:
    """Forward kinematics of 16 joints and five tips from the network's outputs."""

    def __init__(self, model: BodyModel, prior: HandPrior) -> None:
        joints = fold_joints(model)
        tips = model.fingertip_ids
        rest = np.concatenate([joints[0], model.v_template[tips]])
        size = np.concatenate([joints[1], model.shapedirs[tips, :, 0]])
        self.rest, self.size = _tensor(rest / SCALE_M), _tensor(size / SCALE_M)
        self.mean = _tensor(prior.mean)
        self.basis = _tensor(prior.components[:POSE_OUT] * prior.sd[:POSE_OUT, None])
        last = [int(np.argmax(model.weights[tip])) for tip in tips]
        self.parents = [*(int(p) for p in model.parents), *last]

    def __call__(self, out: torch.Tensor) -> torch.Tensor:
        """(B, K, 25) -> keypoints (B, K, 21, 3), in units of 60 mm about the cloud's centre."""
        lead, flat = out.shape[:-1], out.reshape(-1, out.shape[-1])
        fingers = self.mean + flat[:, 9 : 9 + POSE_OUT] @ self.basis
        local = _rotations(fingers.reshape(-1, 15, 3))
        rest = self.rest + flat[:, 9 + POSE_OUT :, None] * self.size
        frames, points = [_from_6d(flat[:, :6])], [rest[:, 0] + flat[:, 6:9]]
        for k in range(1, len(self.parents)):
            up = self.parents[k]
            bone = (rest[:, k] - rest[:, up])[..., None]
            points.append(points[up] + (frames[up] @ bone)[..., 0])
            frames.append(frames[up] @ local[:, k - 1] if k < 16 else frames[up])
        return torch.stack(points, 1).reshape(*lead, len(self.parents), 3)


def _tensor(values: Any) -> torch.Tensor:
    return torch.tensor(np.asarray(values, np.float32))


def _from_6d(six: torch.Tensor) -> torch.Tensor:
    a = six[..., :3] + torch.tensor([1.0, 0, 0])
    b = six[..., 3:] + torch.tensor([0, 1.0, 0])
    x = nn.functional.normalize(a, dim=-1)
    y = nn.functional.normalize(b - (x * b).sum(-1, keepdim=True) * x, dim=-1)
    return torch.stack([x, y, torch.linalg.cross(x, y, dim=-1)], -1)


def _rotations(theta: torch.Tensor) -> torch.Tensor:
    angle = theta.norm(dim=-1, keepdim=True).clamp_min(1e-6)
    x, y, z = (theta / angle).unbind(-1)
    zero = torch.zeros_like(x)
    k = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*theta.shape[:-1], 3, 3)
    a = angle[..., None]
    return torch.eye(3) + torch.sin(a) * k + (1 - torch.cos(a)) * (k @ k)


def train_initialiser(
    model: BodyModel,
    *,
    cpu_seconds: float = 180.0,
    hands: int = 6000,
    seed: int = 0,
    say: Callable[[str], None] = lambda line: None,
) -> Trained:
    """Train for some CPU seconds.

    Parameters
    ----------
    model : BodyModel
        A hand in MANO form; a left hand's initialiser is that of its mirror image.
    cpu_seconds : float
        Of training, the bank of views not counted.
    hands : int
        Hands in the bank.
    say : callable
        Told about progress.

    Raises
    ------
    ModelError
        If the model is no hand with five fingertips.
    """
    if not isinstance(model, ManoModel) or len(model.fingertip_ids) != 5:
        raise ModelError(f"model {model.name!r} is no hand in MANO form; train-init needs one")
    right = mirror_model(model) if model.hand == "left" else model
    prior = learn_prior(right)
    bank = make_bank(right, hands, rng=stream(seed, "corpus", 0, 0, "initialiser bank"))
    say(f"{hands} hands from six sides")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            return _train(right, prior, bank, cpu_seconds, seed, say)
    finally:
        torch.set_num_threads(threads)


def _train(
    model: BodyModel, prior: HandPrior, bank: Bank, budget: float, seed: int, say: Any
) -> Trained:
    rng = stream(seed, "corpus", 0, 0, "initialiser batches")
    net, skeleton = Net(), Skeleton(model, prior)
    optimiser = torch.optim.AdamW(net.parameters(), RATE, weight_decay=1e-4)
    held = max(min(HELD_OUT, len(bank.keypoints) // 10), 2)
    start, steps, recent = time.process_time(), 0, []
    while (share := (time.process_time() - start) / budget) < 1 or steps < 2:
        rate = RATE * min(1, steps / WARM_UP + 0.02) * (0.5 + 0.5 * np.cos(np.pi * min(share, 1)))
        for group in optimiser.param_groups:
            group["lr"] = rate + 1e-5
        ids = rng.integers(len(bank.keypoints) - held, size=BATCH)
        inputs, keypoints = (torch.from_numpy(a) for a in bank.batch(ids, rng=rng))
        out = net(inputs)
        error = (skeleton(out) - keypoints[:, None]).norm(dim=-1).mean(-1)
        best = error.min(1)[0].mean()
        loss = best + 0.05 * error.mean() + 0.005 * (out[..., 9:] ** 2).mean()
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimiser.step()
        recent.append(float(best.detach()))
        steps += 1
        if steps % 300 == 0:
            say(f"step {steps}, keypoints {1e3 * SCALE_M * np.mean(recent[-200:]):.1f} mm")
    net.eval()
    ids = np.arange(len(bank.keypoints) - held, len(bank.keypoints))
    inputs, keypoints = (torch.from_numpy(a) for a in bank.batch(ids, rng=rng))
    with torch.no_grad():
        error = (skeleton(net(inputs)) - keypoints[:, None]).norm(dim=-1).mean(-1).min(1)[0]
    found = np.quantile(error.numpy() * SCALE_M, [0.25, 0.5, 0.75, 0.9])
    names = ("q25", "median", "q75", "q90")
    quantiles = {k: float(v) for k, v in zip(names, found, strict=True)}
    return Trained(_folded(net, model.digest, prior), steps, quantiles)


def _folded(net: Net, digest: str, prior: HandPrior) -> Initialiser:
    """Fold batch norms into the layers before them."""
    weights, biases = {}, {}
    for name in LAYERS:
        part: Any = getattr(net, name)
        if name == "out":
            scale, shift, linear = torch.ones(len(part.bias)), part.bias, part
        else:
            linear, norm = part[0], part[1]
            scale = norm.weight / torch.sqrt(norm.running_var + norm.eps)
            shift = norm.bias - norm.running_mean * scale
        weights[name] = (linear.weight * scale[:, None]).T.detach().numpy().copy()
        biases[name] = shift.detach().numpy().copy()
    return Initialiser(digest, weights, biases, prior)
