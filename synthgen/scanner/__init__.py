"""Speckle-projector active-stereo scanners: rigs, light, exposure, reconstruction."""

from synthgen.scanner.body import body_scene, centred, standing
from synthgen.scanner.depth_sensor import sense_depth
from synthgen.scanner.exposure import expose
from synthgen.scanner.files import save_scan
from synthgen.scanner.load import list_rigs, load_rig
from synthgen.scanner.pipeline import scan
from synthgen.scanner.result import Scan, UnitScan
from synthgen.scanner.rig import Rig
from synthgen.scanner.scaling import scaled
from synthgen.scanner.segment import CropPlane, is_green, segment
from synthgen.scanner.settings import ScanSettings, settings_for
from synthgen.scanner.stage import Effects, prepare
from synthgen.scanner.subject import ScanScene, Solid, Surface, solid_from_mesh
from synthgen.scanner.white import expose_colour

__all__ = [
    "CropPlane",
    "Effects",
    "Rig",
    "Scan",
    "ScanScene",
    "ScanSettings",
    "Solid",
    "Surface",
    "UnitScan",
    "body_scene",
    "centred",
    "expose",
    "expose_colour",
    "is_green",
    "list_rigs",
    "load_rig",
    "prepare",
    "save_scan",
    "scaled",
    "scan",
    "segment",
    "sense_depth",
    "settings_for",
    "solid_from_mesh",
    "standing",
]
