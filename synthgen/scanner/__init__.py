"""Speckle-projector active-stereo scanners: rigs, light, exposure, reconstruction."""

from synthgen.scanner.load import list_rigs, load_rig
from synthgen.scanner.rig import Rig
from synthgen.scanner.subject import ScanScene, Solid, Surface, solid_from_mesh

__all__ = [
    "Rig",
    "ScanScene",
    "Solid",
    "Surface",
    "list_rigs",
    "load_rig",
    "solid_from_mesh",
]
