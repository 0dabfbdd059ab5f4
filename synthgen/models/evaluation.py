"""Evaluation of a batch in single precision."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthgen.models.arguments import Arguments, checked
from synthgen.models.chain import chain, skinning_transforms
from synthgen.models.model import Posed
from synthgen.models.pose_features import feature_joints, rotations_and_features
from synthgen.models.reference import rest

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel

Array = NDArray[np.float64]


def evaluate(
    model: BodyModel, shape: Any, pose: Any, translation: Any, expression: Any, flat: bool | None
) -> Posed:
    """Evaluate a batch; see ``BodyModel.evaluate``."""
    given = checked(model, shape, pose, translation, expression, flat)
    posed, joints, transforms = _placed(model, given)
    skin = skinning_transforms(transforms, joints)
    blended = np.einsum("vk,bkij->bvij", model.weights, skin)
    vertices = np.einsum("bvij,bvj->bvi", blended[..., :3], posed) + blended[..., 3]
    moved = given.translation[:, None]
    transforms[..., :3, 3] += moved
    return Posed(
        vertices=(vertices + moved).astype(np.float32),
        joints=transforms[..., :3, 3].astype(np.float32),
        transforms=transforms,
    )


def evaluate_joints(
    model: BodyModel, shape: Any, pose: Any, translation: Any, expression: Any, flat: bool | None
) -> NDArray[np.float32]:
    """Evaluate joints alone; see ``BodyModel.evaluate_joints``."""
    given = checked(model, shape, pose, translation, expression, flat)
    transforms = _placed(model, given)[2]
    return (transforms[..., :3, 3] + given.translation[:, None]).astype(np.float32)


def _placed(model: BodyModel, given: Arguments) -> tuple[Array, Array, Array]:
    pairs = [rest(model, b, e) for b, e in zip(given.shape, given.expression, strict=True)]
    shaped = np.array([v for v, _ in pairs]).reshape(-1, *model.v_template.shape)
    joints = np.array([j for _, j in pairs]).reshape(-1, len(model.parents), 3)
    rotations, features = rotations_and_features(model, given.pose)
    feature = features[:, feature_joints(model)[0] :].reshape(len(features), -1)
    if model.family == "star":
        second = given.shape[:, 1:2] if given.shape.shape[1] > 1 else np.zeros((len(feature), 1))
        feature = np.concatenate([feature, second], axis=1)
    posed = shaped + np.einsum("vcf,bf->bvc", model.posedirs, feature)
    return posed, joints, chain(rotations, joints, model.parents)
