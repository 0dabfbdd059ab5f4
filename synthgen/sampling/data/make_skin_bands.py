"""Make ``skin_bands.csv``: colour matching functions, illuminant and blood, 31 bands.

Run by hand, in an environment of its own (neither library is a dependency of synthgen)::

    pip install colour-science==0.4.7 mne==1.13.2 scipy
    python make_skin_bands.py skin_bands.csv
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

_HEADER = """\
# Skin model bands, 400-700 nm in steps of 10 nm. Written by make_skin_bands.py.
# xbar ybar zbar: CIE 1931 2 degree observer; d65: CIE illuminant D65 (colour-science 0.4.7, BSD-3).
# hbo2 hb: molar extinction of oxy- and deoxyhaemoglobin, 1/(cm M), compiled by Scott Prahl,
#   https://omlc.org/spectra/hemoglobin, as shipped in mne 1.13.2 (BSD-3).
wavelength_nm,xbar,ybar,zbar,d65,hbo2,hb
"""


def main(target: Path) -> None:
    """Write the table to ``target``."""
    colour: Any = importlib.import_module("colour")
    mne: Any = importlib.import_module("mne")
    shape = colour.SpectralShape(400, 700, 10)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape).values
    d65 = colour.SDS_ILLUMINANTS["D65"].copy().align(shape).values
    blood = loadmat(Path(mne.__file__).parent / "data" / "extinction_coef.mat")["extinct_coef"]
    bands = np.arange(400, 701, 10)
    rows = [
        f"{band},{x:.6f},{y:.6f},{z:.6f},{light:.4f},{oxy:.1f},{deoxy:.1f}"
        for band, (x, y, z), light, oxy, deoxy in zip(
            bands,
            observer,
            d65,
            np.interp(bands, blood[:, 0], blood[:, 1]),
            np.interp(bands, blood[:, 0], blood[:, 2]),
            strict=True,
        )
    ]
    target.write_text(_HEADER + "\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
