"""Hand models: files, evaluation, mirroring, joint tables and the drawn surface."""

from synthgen.models.constrained import ConstrainedTree
from synthgen.models.files import load, load_content, load_hand
from synthgen.models.finding import list_models
from synthgen.models.hand_pca import pose_from_pca
from synthgen.models.inverse import VertexFit, fit_vertices, pca_from_pose
from synthgen.models.keypoints import KEYPOINTS73_NAMES, keypoints73, openpose21
from synthgen.models.mano import ManoModel
from synthgen.models.mirror import mirror_model, mirror_pose
from synthgen.models.model import BodyModel, HandSpace, Posed
from synthgen.models.parts import Part, separate
from synthgen.models.pose_maps import MappedPose, map_pose
from synthgen.models.surface import Arm, HandSurface, pose_surface
from synthgen.models.symmetry import Symmetry, symmetry_of
from synthgen.models.writing import convert

__all__ = [
    "KEYPOINTS73_NAMES",
    "Arm",
    "BodyModel",
    "ConstrainedTree",
    "HandSpace",
    "HandSurface",
    "ManoModel",
    "MappedPose",
    "Part",
    "Posed",
    "Symmetry",
    "VertexFit",
    "convert",
    "fit_vertices",
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
    "separate",
    "symmetry_of",
]
