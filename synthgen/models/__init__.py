"""Hand models: files, evaluation, mirroring, joint tables and the drawn surface."""

from synthgen.models.constrained import ConstrainedTree
from synthgen.models.files import list_models, load
from synthgen.models.hand_pca import pose_from_pca
from synthgen.models.joints import openpose21
from synthgen.models.mano import ManoModel
from synthgen.models.mirror import mirror_model, mirror_pose
from synthgen.models.model import BodyModel, HandSpace, Posed
from synthgen.models.surface import Arm, HandSurface, pose_surface

__all__ = [
    "Arm",
    "BodyModel",
    "ConstrainedTree",
    "HandSpace",
    "HandSurface",
    "ManoModel",
    "Posed",
    "list_models",
    "load",
    "mirror_model",
    "mirror_pose",
    "openpose21",
    "pose_from_pca",
    "pose_surface",
]
