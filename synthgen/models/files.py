"""Loading models: shipped ones, and a user's own MANO, SMPL+H, SUPR and STAR files."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from synthgen.errors import ModelError
from synthgen.models import cache
from synthgen.models.build import build_body, build_hand, side_of
from synthgen.models.content import Content, check_ends, read_content
from synthgen.models.families import checked
from synthgen.models.finding import find, is_shipped, mano_pair
from synthgen.models.mano import ManoModel
from synthgen.models.merging import lacks_hands, merged
from synthgen.models.mirror import mirror_model
from synthgen.models.model import BodyModel, Hand
from synthgen.models.shipped import decoded

Pair = tuple[str | Path, str | Path]


def load(
    name: str | Path,
    *,
    hand: Hand = "right",
    official_left_shape: bool = False,
    mano: Pair | None = None,
) -> BodyModel:
    """Load a model; nothing in its file is ever executed.

    Parameters
    ----------
    name : str or Path
        A model's name (see :func:`list_models`), or the path of a file: MANO or SMPL+H ``.pkl``
        or ``.npz``, SUPR ``.npy``, STAR ``.npz``, or what ``synthgen models convert`` wrote.
    hand : {"right", "left"}
        For hands: a file holds one side; the other is made by mirroring (papers' A.1-A.5). The
        side of a file is taken from its name (``LEFT`` / ``RIGHT``) and otherwise is right.
    official_left_shape : bool
        Keep the published left hand's shape bases, whose x components have the wrong sign
        (they equal the right hand's). By default they are mended; the model's ``warnings`` and
        ``provenance`` say what was done.
    mano : (left, right) or None
        MANO files whose pose spaces an SMPL+H file without any is given. None: the pair beside
        it, where there is one.

    Returns
    -------
    BodyModel
        A :class:`ManoModel` for hands.

    Raises
    ------
    ModelError
        If the model is not found, unreadable, hostile or inconsistent.
    """
    if hand not in ("left", "right"):
        raise ModelError(f"hand={hand!r}; allowed are 'left' and 'right'")
    path = find(name)
    pair = None if mano is None else (find(mano[0]), find(mano[1]))
    stamps = tuple(p.stat().st_mtime_ns for p in (path, *(pair or ())))
    return _load(path, pair, stamps, hand, official_left_shape)


def load_hand(
    name: str | Path, *, hand: Hand = "right", official_left_shape: bool = False
) -> ManoModel:
    """Load a hand; arguments as :func:`load`.

    Raises
    ------
    ModelError
        If it cannot be loaded, or is no hand.
    """
    model = load(name, hand=hand, official_left_shape=official_left_shape)
    if not isinstance(model, ManoModel):
        raise ModelError(
            f"model {model.name!r} is of family {model.family!r} with {len(model.parents)} joints; "
            "a hand in MANO form (16 joints) is needed here"
        )
    return model


def load_content(name: str | Path, *, mano: Pair | None = None) -> Content:
    """Return the checked arrays of a model's file, through the load cache.

    Parameters
    ----------
    name, mano
        As :func:`load`.

    Raises
    ------
    ModelError
        If the model is not found, unreadable, hostile or inconsistent.
    """
    path = find(name)
    return _content(path, None if mano is None else (find(mano[0]), find(mano[1])))


@lru_cache(maxsize=6)
def _load(
    path: Path,
    pair: tuple[Path, Path] | None,
    stamps: tuple[int, ...],
    hand: Hand,
    official_left_shape: bool,
) -> BodyModel:
    content = _content(path, pair)
    if content.family != "mano":
        return build_body(content)
    own = side_of(content)
    if official_left_shape and hand == "left" and own == "right":
        raise ModelError(
            f"{path} is a right hand; official_left_shape needs the published left hand's own file"
        )
    # a right hand made of a left one is right only if the left one's bases are mended
    model = build_hand(content, official_left_shape=official_left_shape and hand == own)
    return model if own == hand else mirror_model(model)


def _content(path: Path, pair: tuple[Path, Path] | None) -> Content:
    for file in (path, *(pair or ())):
        check_ends(file)
    large = path.stat().st_size >= cache.MIN_BYTES
    own = "" if is_shipped(path) else cache.sha256_of(path)
    pair = pair or (mano_pair(path.parent) if large else None)
    if not large:
        return _fresh(path, pair or mano_pair(path.parent), own)
    own = own or cache.sha256_of(path)
    parts = [own, *map(cache.sha256_of, pair or ())]
    key = hashlib.sha256("\n".join(parts).encode()).hexdigest()
    kept = cache.cached(key, path)
    if kept is None:
        kept = _fresh(path, pair, own)
        cache.keep(key, kept)
    return kept


def _fresh(path: Path, pair: tuple[Path, Path] | None, sha256: str) -> Content:
    content = decoded(read_content(path))
    if pair is not None and path not in pair and lacks_hands(content):
        content = merged(content, pair)
    if lacks_hands(content):
        words = (
            "no pose spaces of the hands (hands_mean, hands_components): pass full axis-angle, or "
            "load with mano=(left file, right file)"
        )
        content = replace(content, warnings=(*content.warnings, words))
    return checked(replace(content, sha256=sha256))
