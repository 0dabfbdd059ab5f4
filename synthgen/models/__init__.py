"""Hand and body models: files, evaluation, derivatives, mirroring, parts, the drawn surface."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from synthgen.models.constrained import ConstrainedTree
from synthgen.models.files import load, load_content, load_hand
from synthgen.models.finding import list_models
from synthgen.models.hand_pca import pose_from_pca
from synthgen.models.inverse import pca_from_pose
from synthgen.models.keypoints import KEYPOINTS73_NAMES, keypoints73, openpose21
from synthgen.models.mano import ManoModel
from synthgen.models.mirror import mirror_model, mirror_pose
from synthgen.models.model import BodyModel, HandSpace, Posed
from synthgen.models.parts import Part, separate
from synthgen.models.pose_maps import MappedPose, map_pose
from synthgen.models.recentre import recentre
from synthgen.models.surface import Arm, HandSurface, pose_surface
from synthgen.models.symmetry import Symmetry, symmetry_of
from synthgen.models.vertex_fit import VertexFit, fit_vertices
from synthgen.models.writing import convert

if TYPE_CHECKING:
    from synthgen.models.as_torch_layer import as_torch
    from synthgen.models.dress import Attachment, attachments_of, dressed
    from synthgen.models.foot import FootNetwork, deform_feet, feet_of, touching
    from synthgen.models.jacobian import Jacobian
    from synthgen.models.vjp import Forward, Gradient, forward

# Brought in when asked for: what these rest on (torch, compiled kernels) is slow to import.
_LATE = {
    "as_torch": "as_torch_layer",
    "Attachment": "dress",
    "attachments_of": "dress",
    "dressed": "dress",
    "FootNetwork": "foot",
    "deform_feet": "foot",
    "feet_of": "foot",
    "touching": "foot",
    "Jacobian": "jacobian",
    "Forward": "vjp",
    "Gradient": "vjp",
    "forward": "vjp",
}

__all__ = [
    "KEYPOINTS73_NAMES",
    "Arm",
    "Attachment",
    "BodyModel",
    "ConstrainedTree",
    "FootNetwork",
    "Forward",
    "Gradient",
    "HandSpace",
    "HandSurface",
    "Jacobian",
    "ManoModel",
    "MappedPose",
    "Part",
    "Posed",
    "Symmetry",
    "VertexFit",
    "as_torch",
    "attachments_of",
    "convert",
    "deform_feet",
    "dressed",
    "feet_of",
    "fit_vertices",
    "forward",
    "keypoints73",
    "list_models",
    "load",
    "load_content",
    "load_hand",
    "map_pose",
    "mirror_model",
    "mirror_pose",
    "openpose21",
    "pca_from_pose",
    "pose_from_pca",
    "pose_surface",
    "recentre",
    "separate",
    "symmetry_of",
    "touching",
]


def __getattr__(name: str) -> Any:
    """Load a name whose module is slow to import, on first use."""
    from importlib import import_module

    if name in _LATE:
        return getattr(import_module(f"synthgen.models.{_LATE[name]}"), name)
    raise AttributeError(f"module 'synthgen.models' has no attribute {name!r}; it has {__all__}")
