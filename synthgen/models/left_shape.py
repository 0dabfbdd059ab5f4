"""Published left hands carry the right hand's shape bases: find that out and mend it.

In ``MANO_LEFT`` of version 1.2 the x components of ``shapedirs`` have the wrong sign: they equal
those of ``MANO_RIGHT`` where they should be their mirror image. Corpora and fits made with the
file as it is differ from those made with the mended one, so what was done is recorded.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from synthgen.errors import ModelError
from synthgen.models.content import Array, Content, read_content
from synthgen.models.finding import twin

LeftShape = Literal["as in file", "mended", "official"]
_MIRROR = np.array([-1.0, 1.0, 1.0])[:, None]
# A component that grows the hand explains this share of its own x and of its own y, z motion.
_SURE = 0.1


def left_shapedirs(
    content: Content, shapedirs: Array, *, official: bool
) -> tuple[Array, LeftShape, tuple[str, ...]]:
    """Return a left hand's shape bases, what was done to them, and warnings.

    Parameters
    ----------
    content : Content
        Of a left hand's file.
    shapedirs : (V, 3, nb)
    official : bool
        Keep the published bases.
    """
    bug = has_bug(content, shapedirs)
    if bug is None:
        words = (
            "the left hand's shape bases could not be judged: no MANO_RIGHT beside the file, and "
            "none of its components scales the hand; taken as they are"
        )
        return shapedirs, "as in file", (words,)
    if not bug:
        return shapedirs, "as in file", ()
    if official:
        words = "official_left_shape: x of the shape bases has the published, wrong sign"
        return shapedirs, "official", (words,)
    words = "x of the published shape bases had the right hand's sign and was negated"
    return shapedirs * _MIRROR, "mended", (words,)


def has_bug(content: Content, shapedirs: Array) -> bool | None:
    """Tell whether a left hand carries the right hand's bases; None if it cannot be told.

    The right file beside it decides; without one the hand's own shape does.
    """
    beside = twin(content.path)
    if beside is not None:
        try:
            right = read_content(beside).numbers("shapedirs")
        except ModelError:
            right = np.zeros(0)
        if right.shape == shapedirs.shape:
            same = np.abs(shapedirs - right).sum()
            return bool(same < np.abs(shapedirs - right * _MIRROR).sum())
    return against_growth(content.numbers("v_template"), shapedirs)


def against_growth(v_template: Array, shapedirs: Array) -> bool | None:
    """Tell from a hand alone whether x of its shape bases has the wrong sign.

    The first components of any population of hands are mostly size: a hand that grows along y
    and z grows along x. Where x shrinks instead, its sign is wrong.

    Returns
    -------
    bool or None
        None if no component scales the hand clearly enough.
    """
    away = v_template - v_template.mean(axis=0)
    motion = shapedirs - shapedirs.mean(axis=0)
    along = _correlation(away[:, :1], motion[:, :1])
    across = _correlation(away[:, 1:], motion[:, 1:])
    share = np.abs(along * across)
    best = int(share.argmax())
    if share[best] < _SURE:
        return None
    return bool(along[best] * across[best] < 0)


def _correlation(away: Array, motion: Array) -> Array:
    """Correlation of each component (V, c, nb) with growth about the centre (V, c)."""
    dot = np.einsum("vc,vcs->s", away, motion)
    size = np.linalg.norm(away) * np.sqrt(np.einsum("vcs,vcs->s", motion, motion))
    return np.asarray(dot / np.maximum(size, 1e-300))
