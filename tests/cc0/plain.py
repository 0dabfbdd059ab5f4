"""A plain float64 evaluation of the shipped bodies, for tests: no model class, no shortcuts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from synthgen.models.dress import Attachment, pose_attachment
from synthgen.models.files import DATA
from synthgen.models.mano import chain, skinning_transforms
from synthgen.models.compact import expand, regressor

Array = NDArray[np.float64]


class PlainBody:
    """A shipped body from its compact arrays."""

    def __init__(self, compact: dict[str, Any]) -> None:
        self.compact = compact
        self.arrays = expand(compact)
        self.form = str(compact["shipped_form"])
        self.parents = self.arrays["kintree_table"][0]
        self.names = tuple(map(str, self.arrays["joint_names"]))
        self.faces = self.arrays["f"].astype(np.int64)
        self.weights = self.arrays["weights"]
        self.template = self.arrays["v_template"].astype(np.float64)
        self.regressor = regressor(compact)
        self.shapedirs = self.arrays["shapedirs"]
        self.exprdirs = self.arrays.get("exprdirs")
        self.posedirs = self.arrays["posedirs"]
        self.n_betas = self.shapedirs.shape[2]

    def pose(self, **degrees: tuple[float, float, float]) -> Array:
        """One pose (1, K, 3) from axis-angle vectors in degrees by joint name."""
        result = np.zeros((1, len(self.names), 3))
        for name, vector in degrees.items():
            result[0, self.names.index(name)] = np.deg2rad(vector)
        return result

    def feature(self, poses: Array) -> Array:
        """Pose feature (n, F)."""
        turns = Rotation.from_rotvec(poses.reshape(-1, 3))
        if self.form == "smplh":
            values = (turns.as_matrix() - np.eye(3)).reshape(len(poses), -1, 9)[:, 1:]
        else:
            values = turns.as_quat(canonical=True).reshape(len(poses), -1, 4) - [0, 0, 0, 1]
        return values.reshape(len(poses), -1)

    def rest(self, betas: Array, expression: Array | None = None) -> Array:
        """Shaped vertices (n, V, 3)."""
        shaped = self.template + np.einsum(
            "vcs,ns->nvc", self.arrays["shapedirs"][..., : betas.shape[1]], betas
        )
        if expression is not None:
            basis = self.arrays["exprdirs"][..., : expression.shape[1]]
            shaped = shaped + np.einsum("vce,ne->nvc", basis, expression)
        return shaped

    def frames(self, poses: Array, betas: Array) -> tuple[Array, Array]:
        """Joint frames (n, K, 4, 4) and rest joints (n, K, 3)."""
        shaped = self.rest(betas)
        joints = np.stack([self.regressor @ v for v in shaped])
        turns = Rotation.from_rotvec(poses.reshape(-1, 3)).as_matrix()
        return chain(turns.reshape(*poses.shape[:2], 3, 3), joints, self.parents), joints

    def evaluate(
        self, poses: Array, betas: Array | None = None, expression: Array | None = None,
        correctives: bool = True,
    ) -> Array:  # fmt: skip
        """Posed vertices (n, V, 3)."""
        betas = np.zeros((len(poses), 1)) if betas is None else betas
        frames, joints = self.frames(poses, betas)
        rest = self.rest(betas, expression)
        if correctives:
            rest = rest + np.einsum("vcf,nf->nvc", self.arrays["posedirs"], self.feature(poses),
                                    optimize=True)  # fmt: skip
        maps = skinning_transforms(frames, joints)
        blended = (self.weights @ maps.reshape(len(maps), -1, 12)).reshape(len(maps), -1, 3, 4)
        return np.einsum("nvij,nvj->nvi", blended[..., :3], rest) + blended[..., 3]

    def dressed(
        self, attachment: Attachment, poses: Array, betas: Array | None = None,
        expression: Array | None = None,
    ) -> Array:  # fmt: skip
        """Posed vertices of an attachment, (n, A, 3)."""
        betas = np.zeros((len(poses), 1)) if betas is None else betas
        frames, joints = self.frames(poses, betas)
        return pose_attachment(attachment, betas, frames, joints, self.feature(poses), expression)


def shipped(name: str) -> PlainBody:
    """Read a shipped model."""
    with np.load(DATA / f"{name}.npz", allow_pickle=False) as file:
        return PlainBody({key: file[key] for key in file.files})
