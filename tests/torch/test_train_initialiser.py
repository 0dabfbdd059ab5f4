"""Training the initialiser: a short run, the folded network, its file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from synthgen import models
from synthgen.errors import ModelError
from synthgen.models import mirror_model
from synthgen.registration.bank import make_bank
from synthgen.registration.initialiser import initialiser_of, initialiser_path, load_initialiser
from synthgen.registration.prior import learned_prior
from synthgen.registration.surface import surface_of
from synthgen.sampling.streams import stream
from synthgen.torch.train_initialiser import Net, Skeleton, _folded, train_initialiser


def cc0() -> models.ManoModel:
    model = models.load("cc0-hand")
    assert isinstance(model, models.ManoModel)
    return model


def test_reference_folded_network_is_the_trained_one() -> None:
    torch.manual_seed(0)
    net = Net()
    x = torch.randn(8, 128, 6)
    net.train()
    for _ in range(3):
        net(x)  # moves the running means
    net.eval()
    folded = _folded(net, "d", learned_prior(cc0()))
    with torch.no_grad():
        expected = net(x).numpy()
    np.testing.assert_allclose(folded.forward(x.numpy()), expected, atol=1e-4)


def test_reference_skeleton_is_the_models() -> None:
    model, prior = cc0(), learned_prior(cc0())
    out = torch.zeros(1, 1, 25)
    out[..., 9:24] = torch.randn(15, generator=torch.Generator().manual_seed(1))
    out[..., 24] = 0.7
    surface = surface_of(model)
    fingers = prior.mean + out[0, 0, 9:24].numpy() @ (prior.components[:15] * prior.sd[:15, None])
    pose = np.concatenate([np.zeros(3), fingers]).reshape(16, 3)
    placed = surface.at(surface.pack(np.array([0.7]), pose, np.zeros(3)))
    found = Skeleton(model, prior)(out)[0, 0].numpy() * 0.06
    np.testing.assert_allclose(found[:16], placed.joints, atol=1e-5)


def test_properties_bank_batches() -> None:
    rng = stream(0, "corpus", 0, 0, "bank test")
    bank = make_bank(cc0(), 12, rng=rng)
    inputs, keypoints = bank.batch(np.arange(12), rng=rng)
    assert inputs.shape == (12, 128, 6)
    assert keypoints.shape == (12, 21, 3)
    np.testing.assert_allclose(inputs[..., :3].mean(axis=1), 0, atol=0.2)
    np.testing.assert_allclose(np.linalg.norm(inputs[..., 3:], axis=2), 1, atol=1e-4)


def test_smoke_short_training_and_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trained = train_initialiser(mirror_model(cc0()), cpu_seconds=1.0, hands=100)
    assert trained.steps >= 2
    assert 0 < trained.error_m["median"] < 0.2
    assert trained.initialiser.digest == cc0().digest
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    file = initialiser_path(cc0())
    assert file.is_relative_to(tmp_path)
    trained.initialiser.save(file)
    again = load_initialiser(file)
    x = np.zeros((1, 128, 6), np.float32)
    np.testing.assert_array_equal(again.forward(x), trained.initialiser.forward(x))


def test_properties_shipped_one_is_tied_to_its_model() -> None:
    from dataclasses import replace

    assert initialiser_of(cc0()) is not None
    assert initialiser_of(replace(cc0(), digest="0" * 64)) is None


def test_edge_no_hand() -> None:
    from dataclasses import replace

    with pytest.raises(ModelError, match="no hand"):
        train_initialiser(replace(cc0(), fingertip_ids=np.zeros(0, np.int64)))
