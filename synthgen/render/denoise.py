"""Intel Open Image Denoise, an optional extra; which denoiser was used is part of the plan."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import BackendError
from synthgen.render.radiance import Guides

Image = NDArray[np.float32]


def denoise(linear: Image, guides: Guides) -> Image:
    """Denoise a linear picture (H, W, 3), led by albedo and normals.

    Raises
    ------
    BackendError
        If the extra is missing; the plan asked for it, so nothing else may take its place.
    """
    try:
        module: Any = import_module("mitsuba_oidn")
    except ImportError as error:
        raise BackendError(
            f"the plan asks for the denoiser oidn, which is not installed ({error}); run `pip "
            "install mitsuba-oidn`, or set render.denoise=none and a higher render.spp"
        ) from None
    done = module.denoise(
        np.ascontiguousarray(linear), albedo=guides.albedo, normal=guides.normal, hdr=True
    )
    return np.maximum(np.array(done, dtype=np.float32), 0)
