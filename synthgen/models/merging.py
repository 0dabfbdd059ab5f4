"""A body file without hand pose spaces and a pair of MANO files, merged in memory."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from synthgen.models.content import Content, read_content

HAND_KEYS = ("hands_mean", "hands_components", "hands_coeffs")


def lacks_hands(content: Content) -> bool:
    """Tell whether a body has 52 joints (fingers among them) but no pose space for them."""
    weights = content.arrays.get("weights")
    fifty_two = weights is not None and weights.shape[1:] == (52,)
    return fifty_two and not any(key.startswith("hands_") for key in content.arrays)


def merged(content: Content, pair: tuple[Path, Path]) -> Content:
    """Return the body with the pose spaces of a left and a right MANO file.

    Parameters
    ----------
    content : Content
        Of a body.
    pair : (Path, Path)
        Left, right.

    Raises
    ------
    ModelError
        If a MANO file is unreadable or has no pose space.
    """
    for side, path in zip("lr", pair, strict=True):
        hand = read_content(path)
        for key in HAND_KEYS[:2]:
            if key not in hand.arrays:
                raise hand.fail(f"no {key}: the hand's pose space (PCA) is missing")
        found = {f"{k}{side}": hand.arrays[k] for k in HAND_KEYS if k in hand.arrays}
        content = content.having(**found)
    words = f"pose spaces of the hands come from {pair[0].name} and {pair[1].name}"
    return replace(content, warnings=(*content.warnings, words))
