"""Models: CPU milliseconds of evaluation, derivatives and loading, beside smplx where installed.

Files are random, of the real sizes. Without smplx, and for SUPR always, the peer is the dense
formulation of the same equations in torch. Bursts of ours and of the peer take turns, so that both
meet the same machine. The generators of the tests make the files.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

TESTS = Path(__file__).resolve().parents[1] / "tests" / "models"
PAIRS = {"mano": 385, "smplh": 3441, "supr": 5233}  # 778, 6890 and 10474 vertices
SECONDS, BURST = 2.0, 0.1  # of both together for each line, and of one without a break
CALLS = 7  # of either at least: the median of three would be one of the extremes now and then
Call = Callable[[], Any]


def run() -> dict[str, Any]:
    """Time every line of the table with one thread."""
    import torch

    torch.set_num_threads(1)
    quiet = contextlib.redirect_stdout(io.StringIO())  # smplx prints to stdout
    with threadpool_limits(limits=1), warnings.catch_warnings(), quiet:
        warnings.simplefilter("ignore")
        rows, notes = _rows()
    return {
        "title": "Models, one thread, CPU ms a call: medians of alternating bursts",
        "columns": ["what", "ours", "peer", "peer's name", "times faster", "target"],
        "rows": rows,
        "notes": notes,
    }


def _rows() -> tuple[list[list[Any]], list[str]]:
    mano, smplh, supr = (_model(kind) for kind in ("mano", "smplh", "supr"))
    rows, notes = [], []
    for made, few, many in ((mano, 10, 4), (smplh, 3.3, 3.8)):
        for n, target in ((1, few), (16, None), (256, many)):
            rows.append(_forward(made, n, target))
    rows += [_forward(_local(smplh), n, None, "hands' zeros") for n in (1, 256)]
    rows += [_forward(supr, n, target) for n, target in ((1, 20), (16, None))]
    rows += [_pull(made, target) for made, target in ((mano, 8), (smplh, 4))]
    row, note = _jacobian(mano)
    rows.append(row)
    notes.append(note)
    notes += [_bandwidth(smplh, "dense"), _bandwidth(_local(smplh), "hands' zeros left out")]
    notes += _loading()
    if find_spec("smplx") is None:
        notes.append("smplx is not installed: the peer is the dense formulation in torch")
    return rows, notes


# --- the lines


def _forward(made: Any, n: int, target: float | None, what: str = "") -> list[Any]:
    given = _draw(made, n)
    peer = _peer(made, n)
    call = _inference(peer, given)
    error = np.abs(call().numpy() - made.evaluate(*given[:3]).vertices).max()
    assert error < 1e-5, f"{made.name}: {peer.name} differs by {error} m"
    ours, theirs = _take_turns(lambda: made.evaluate(*given[:3]), call)
    name = " ".join(filter(None, (made.name, "forward,", f"B = {n}", what and f"({what})")))
    return _row(name, ours, theirs, peer.name, target)


def _pull(made: Any, target: float) -> list[Any]:
    from synthgen.models.vjp import forward

    given = _draw(made, 1)
    peer = _peer(made, 1)

    def ours() -> Any:
        state = forward(made, *given[:3])
        return state.pull(2 * state.vertices)

    def theirs() -> Any:
        tensors = [t.requires_grad_() for t in _tensors(given)]
        peer.vertices(*tensors).square().sum().backward()
        return [t.grad.numpy() for t in tensors]

    got, want = ours(), theirs()
    close = np.abs(got.pose.ravel() - want[1].ravel()).max() / np.abs(want[1]).max()
    assert close < 1e-4, f"gradients differ by {close}"
    return _row(f"{made.name} forward + VJP, B = 1", *_take_turns(ours, theirs), peer.name, target)


def _jacobian(made: Any) -> tuple[list[Any], str]:
    import torch

    from synthgen.models.jacobian_reference import jacobian_reference

    given = _draw(made, 1)
    peer = _peer(made, 1)
    beta, pose, move = (a[0] for a in given[:3])
    tensors = _tensors(given)
    whole = torch.cat([tensors[0].ravel(), tensors[1].ravel()])
    nb = len(beta)

    def at(x: Any) -> Any:
        return peer.vertices(x[None, :nb], x[nb:].reshape(1, -1, 3), tensors[2])[0]

    times = _take_turns(
        lambda: made.jacobian(beta, pose, move), lambda: torch.func.jacfwd(at)(whole)
    )
    error = np.abs(made.jacobian(beta, pose).values - jacobian_reference(made, beta, pose)).max()
    name = f"{peer.name} jacfwd"
    note = f"Jacobian against float64: {error:.1e} (wanted: <= 1e-6)"
    return _row(f"{made.name} full Jacobian", *times, name, 12), note


def _bandwidth(made: Any, what: str) -> str:
    """Bytes that a single evaluation must read, over the rate of a plain product in this run."""
    given = _draw(made, 1)
    rows, columns = made.packed.basis.shape
    plain = np.ones((max(rows, 470), columns), np.float32)  # larger than the caches
    vector = np.ones(len(plain), np.float32)
    ours, stream = _take_turns(lambda: made.evaluate(*given[:3]), lambda: vector @ plain)
    limit = stream * made.packed.nbytes / plain.nbytes
    rate = plain.nbytes / stream / 1e6
    return (
        f"{made.name}, B = 1, {what}: {made.packed.nbytes / 1e6:.1f} MB at {rate:.0f} GB/s = "
        f"{limit:.2f} ms, {100 * limit / ours:.0f} % of it reached (wanted: >= 65 %)"
    )


def _loading() -> list[str]:
    """Read a raw SMPL+H pickle of the real size, first afresh and then from the cache."""
    from synthgen.models import files as files_module
    from synthgen.models import load

    files = _generator("body_files")
    content = files.body("smplh", pairs=PAIRS["smplh"], betas=10)
    values = {
        **content,
        "J_regressor": files.csc(content["J_regressor"]),
        "weights_prior": content["weights"][:, :24],
        **{k: files.chumpy(content[k]) for k in ("weights", "posedirs", "v_template")},
        "shapedirs": files.selected(content["shapedirs"]),
    }
    times = []
    with tempfile.TemporaryDirectory() as folder, _cache_in(Path(folder) / "cache"):
        path = files.write_python2(Path(folder) / "SMPLH_male.pkl", values)
        size = path.stat().st_size / 1e6
        time.sleep(2.5)  # the hash of a file is remembered once its time stamp has settled
        for _ in range(2):
            begun = time.process_time()
            load(path)
            times.append(time.process_time() - begun)
            files_module._load.cache_clear()  # as a new process: the cache on disk alone is left
    return [
        f"load of a {size:.0f} MB SMPL+H pickle: {times[0]:.2f} CPU s (wanted: <= 1.5), from the "
        f"cache {times[1]:.2f} (wanted: <= 0.1)"
    ]


def _row(name: str, ours: float, theirs: float, peer: str, target: float | None) -> list[Any]:
    wanted = "" if target is None else f">= {target}"
    return [name, ours, theirs, peer, theirs / ours, wanted]


# --- models and their arguments


def _generator(name: str) -> Any:
    if str(TESTS) not in sys.path:
        sys.path.insert(0, str(TESTS))
    return importlib.import_module(name)


def _model(kind: str) -> Any:
    made = _generator("random_models").model(kind, pairs=PAIRS[kind], betas=10, active=0.06)
    order = np.argsort(-made.weights, axis=1)[:, 4:]
    weights = made.weights.copy()
    np.put_along_axis(weights, order, 0, axis=1)
    return replace(made, weights=weights / weights.sum(axis=1, keepdims=True))


def _local(smplh: Any) -> Any:
    """SMPL+H whose fingers correct the two hands only, as section 3.4 of the paper makes it."""
    posedirs = smplh.posedirs.copy()
    for first, at in ((21, 1000), (36, 4000)):
        columns = slice(9 * first, 9 * (first + 15))
        inside = np.zeros(len(posedirs), dtype=bool)
        inside[at : at + 778] = True
        posedirs[~inside, :, columns] = 0
    return replace(smplh, posedirs=posedirs)


def _draw(made: Any, n: int) -> tuple[Any, ...]:
    given = _generator("random_models").draw(made, n, spread=0.4)
    return tuple(None if a is None else a.astype(np.float32) for a in given)


# --- peers


class Peer(NamedTuple):
    """Vertices (B, V, 3) by somebody else, from tensors of shape, pose and translation."""

    name: str
    vertices: Callable[..., Any]


def _tensors(given: tuple[Any, ...]) -> list[Any]:
    import torch

    return [torch.tensor(a) for a in given[:3]]


def _inference(peer: Peer, given: tuple[Any, ...]) -> Call:
    import torch

    tensors = _tensors(given)

    def call() -> Any:
        with torch.no_grad():
            return peer.vertices(*tensors)

    return call


def _peer(made: Any, n: int) -> Peer:
    if made.family in ("mano", "smplh") and find_spec("smplx") is not None:
        return _smplx(made, n)
    return Peer("dense torch", _dense(made))


def _smplx(made: Any, n: int) -> Peer:
    import smplx
    from smplx.utils import Struct

    table = np.stack([made.parents, np.arange(len(made.parents))])
    table[0, 0] = 2**32 - 1
    hands = {f"hands_{what}{s}": value for s in ("", "l", "r")
             for what, value in (("mean", np.zeros(45)), ("components", np.eye(45)))}  # fmt: skip
    arrays = {key: getattr(made, key) for key in
              ("v_template", "shapedirs", "posedirs", "weights", "J_regressor")}  # fmt: skip
    data = Struct(**arrays, **hands, kintree_table=table, f=made.faces)
    options = {"data_struct": data, "use_pca": False, "flat_hand_mean": True, "batch_size": n}
    if made.family == "mano":
        hand = smplx.MANO("", is_rhand=True, **options)

        def vertices(b: Any, p: Any, t: Any) -> Any:
            fingers = p[:, 1:].flatten(1)
            return hand(betas=b, global_orient=p[:, 0], hand_pose=fingers, transl=t).vertices
    else:
        body = smplx.SMPLH("", num_betas=made.n_shape, **options)

        def vertices(b: Any, p: Any, t: Any) -> Any:
            parts = {"body_pose": p[:, 1:22], "left_hand_pose": p[:, 22:37],
                     "right_hand_pose": p[:, 37:]}  # fmt: skip
            flat = {key: value.flatten(1) for key, value in parts.items()}
            return body(betas=b, global_orient=p[:, 0], transl=t, **flat).vertices

    return Peer("smplx", vertices)


def _dense(made: Any) -> Callable[..., Any]:
    """Write the equations as published layers do: every matrix dense, one step after another."""
    import torch

    keys = ("v_template", "shapedirs", "posedirs", "weights", "J_regressor")
    v, s, p, w, j = (torch.tensor(getattr(made, k), dtype=torch.float32) for k in keys)
    parents = made.parents.tolist()

    def vertices(beta: Any, pose: Any, move: Any) -> Any:
        n, k = pose.shape[:2]
        shaped = v + torch.einsum("vcs,bs->bvc", s, beta)
        angle = (pose + 1e-8).norm(dim=-1, keepdim=True)
        axis = pose / angle
        if made.family == "supr":
            one = torch.ones((n, 1))
            joints = (torch.cat([shaped.flatten(1), one], 1) @ j.T).reshape(n, k, 3)
            half = 0.5 * angle
            feature = torch.cat([axis * half.sin(), half.cos() - 1], -1).flatten(1)
        else:
            joints = torch.einsum("kv,bvc->bkc", j, shaped)
        turns = _rodrigues(axis, angle)
        if made.family != "supr":
            feature = (turns[:, 1:] - torch.eye(3)).flatten(1)
        posed = shaped + torch.einsum("vcf,bf->bvc", p, feature)
        maps = _chain(turns, joints, parents)
        blended = torch.einsum("vk,bkij->bvij", w, maps)
        moved = (blended[..., :3] @ posed[..., None])[..., 0] + blended[..., 3]
        return moved + move[:, None]

    return vertices


def _rodrigues(axis: Any, angle: Any) -> Any:
    import torch

    x, y, z = axis.unbind(-1)
    o = torch.zeros_like(x)
    cross = torch.stack([o, -z, y, z, o, -x, -y, x, o], -1).unflatten(-1, (3, 3))
    sine, cosine = angle.sin()[..., None], angle.cos()[..., None]
    return torch.eye(3) + sine * cross + (1 - cosine) * (cross @ cross)


def _chain(turns: Any, joints: Any, parents: list[int]) -> Any:
    import torch

    turned, placed = [turns[:, 0]], [joints[:, 0]]
    for k, p in enumerate(parents[1:], start=1):
        turned.append(turned[p] @ turns[:, k])
        step = (joints[:, k] - joints[:, p])[..., None]
        placed.append(placed[p] + (turned[p] @ step)[..., 0])
    g, t = torch.stack(turned, 1), torch.stack(placed, 1)
    return torch.cat([g, (t - (g @ joints[..., None])[..., 0])[..., None]], -1)


# --- clocks


def _take_turns(ours: Call, theirs: Call) -> tuple[float, float]:
    """Median CPU milliseconds of both, in alternating bursts of BURST seconds."""
    times: tuple[list[float], list[float]] = ([], [])
    end = time.perf_counter() + SECONDS
    while time.perf_counter() < end or len(times[1]) < CALLS:
        for call, own in zip((ours, theirs), times, strict=True):
            call()  # what the other left in the caches is not ours to answer for
            stop = time.perf_counter() + BURST
            while time.perf_counter() < stop or not own:
                begun = time.process_time_ns()
                call()
                own.append((time.process_time_ns() - begun) / 1e6)
    return statistics.median(times[0]), statistics.median(times[1])


@contextlib.contextmanager
def _cache_in(folder: Path) -> Any:
    import os

    before = os.environ.get("SYNTHGEN_CACHE")
    os.environ["SYNTHGEN_CACHE"] = str(folder)
    try:
        yield
    finally:
        os.environ.pop("SYNTHGEN_CACHE")
        if before is not None:
            os.environ["SYNTHGEN_CACHE"] = before
