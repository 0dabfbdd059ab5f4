"""Plain skin: three colours by masks, a little noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from synthgen.models import load
from synthgen.render.skin.plain import TEXTURE_PX, bake, maps_of
from synthgen.sampling.appearance import sample_skin
from synthgen.sampling.streams import stream
from synthgen.scene import Skin


def person(**changes: object) -> Skin:
    skin, _ = sample_skin((0.6, 0.6), rng=stream(4, "subject", 0, 0, "skin"))
    return replace(skin, **changes)  # type: ignore[arg-type]


def test_smoke_shape() -> None:
    picture = bake(load("cc0-hand"), person())
    assert picture.shape == (TEXTURE_PX, TEXTURE_PX, 3)
    assert picture.dtype == np.float32


def test_reference_zones_have_their_colours() -> None:
    model, skin = load("cc0-hand"), person(mottle=0.0)
    maps, picture = maps_of(model), bake(model, skin)
    for mask, colour in ((maps.palm, skin.palm_rgb), (maps.nail, skin.nail_rgb)):
        own = (mask > 0.999) & (maps.knuckle < 0.01)
        if mask is maps.palm:
            own &= maps.nail == 0
        assert own.sum() > 50
        np.testing.assert_allclose(picture[own].mean(axis=0), colour, rtol=0.03)


def test_properties_one_bake_per_person() -> None:
    model = load("cc0-hand")
    assert bake(model, person()) is bake(model, person())
    assert not np.array_equal(bake(model, person()), bake(model, person(seed=1)))
