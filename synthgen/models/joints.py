"""Names and orders of joints; vertex ids of the named points of published meshes.

Functions find joints by name, never by position: two files of one family may order them apart.
"""

from __future__ import annotations

from typing import Final

FINGERS: Final = ("index", "middle", "pinky", "ring", "thumb")
MANO16_NAMES: Final = ("wrist", *(f"{f}{k}" for f in FINGERS for k in (1, 2, 3)))
MANO16_PARENTS: Final = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)

# MANO-21 = the 16 joints, then thumb, index, middle, ring, pinky tips.
OPENPOSE21_FROM_MANO21: Final = (
    0, 13, 14, 15, 16, 1, 2, 3, 17, 4, 5, 6, 18, 10, 11, 12, 19, 7, 8, 9, 20,
)  # fmt: skip
OPENPOSE21_NAMES: Final = (
    "wrist",
    *(f"{f}_{k}" for f in ("thumb", "index", "middle", "ring", "pinky") for k in range(1, 5)),
)
OPENPOSE21_BONES: Final = tuple(
    (0 if k == 0 else 4 * f + k, 4 * f + k + 1) for f in range(5) for k in range(4)
)
# MANO joint whose bone carries each OpenPose keypoint (tips ride on the last joint).
OPENPOSE21_JOINT: Final = (0, 13, 14, 15, 15, 1, 2, 3, 3, 4, 5, 6, 6, 10, 11, 12, 12, 7, 8, 9, 9)

# Fingertip vertices of 778-vertex MANO meshes; libraries disagree, so the choice has a name.
MANO778_TIPS: Final = {
    "smplx": (744, 320, 443, 554, 671),
    "freihand": (744, 320, 443, 555, 672),
    "manopth": (745, 317, 444, 556, 673),
}
PART_FOREARM: Final = 17
PART_SLEEVE: Final = 18
PART_OBJECT: Final = 19

SIDES: Final = ("left", "right")
TIP_ORDER: Final = ("thumb", "index", "middle", "ring", "pinky")
_TOES: Final = ("bigtoe", "indextoe", "middletoe", "ringtoe", "pinkytoe")
_BODY22: Final = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2",
    "left_ankle", "right_ankle", "spine3", "left_foot", "right_foot", "neck", "left_collar",
    "right_collar", "head", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow",
    "left_wrist", "right_wrist",
)  # fmt: skip
_BODY22_PARENTS: Final = (
    -1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19,
)  # fmt: skip
_HANDS30: Final = tuple(f"{s}_{f}{k}" for s in SIDES for f in FINGERS for k in (1, 2, 3))
_TOES20: Final = tuple(f"{s}_{toe}{k}" for s in SIDES for toe in _TOES for k in (1, 2))

SMPLH52_NAMES: Final = (*_BODY22, *_HANDS30)
SUPR75_NAMES: Final = (*_BODY22, "jaw", "left_eye", "right_eye", *_HANDS30, *_TOES20)
STAR24_NAMES: Final = (*_BODY22, "left_hand", "right_hand")
FOOT13_NAMES: Final = (
    "knee", "ankle", "foot", *(f"{toe}{k}" for toe in _TOES for k in (1, 2)),
)  # fmt: skip


def _parents(names: tuple[str, ...]) -> tuple[int, ...]:
    place = {name: k for k, name in enumerate(names)}
    roots = {
        "jaw": "head", "left_eye": "head", "right_eye": "head", "left_hand": "left_wrist",
        "right_hand": "right_wrist",
    }  # fmt: skip
    result = list(_BODY22_PARENTS)
    for name in names[len(_BODY22) :]:
        side, _, digit = name.partition("_")
        if name in roots:
            result.append(place[roots[name]])
        elif digit[-1] == "1":
            result.append(place[f"{side}_{'foot' if 'toe' in digit else 'wrist'}"])
        else:
            result.append(place[f"{name[:-1]}{int(name[-1]) - 1}"])
    return tuple(result)


SMPLH52_PARENTS: Final = _parents(SMPLH52_NAMES)
SUPR75_PARENTS: Final = _parents(SUPR75_NAMES)
STAR24_PARENTS: Final = _parents(STAR24_NAMES)

# Points of the skin that the usual 73-joint list of SMPL+H adds to the 52 joints, and where they
# are on the published meshes of 6890 and of 10475 vertices.
LANDMARK_NAMES: Final = (
    "nose", "right_eye", "left_eye", "right_ear", "left_ear",
    "left_big_toe", "left_small_toe", "left_heel",
    "right_big_toe", "right_small_toe", "right_heel",
)  # fmt: skip
LANDMARKS: Final = {
    6890: (332, 6260, 2800, 4071, 583, 3216, 3226, 3387, 6617, 6624, 6787),
    10475: (9120, 9929, 9448, 616, 6, 5770, 5780, 8846, 8463, 8474, 8635),
}
# Fingertips of bodies: left thumb, index, middle, ring, pinky, then right.
BODY_TIPS: Final = {
    6890: (2746, 2319, 2445, 2556, 2673, 6191, 5782, 5905, 6016, 6133),
    10475: (5361, 4933, 5058, 5169, 5286, 8079, 7669, 7794, 7905, 8022),
}


def swapped_side(name: str) -> str:
    """Return the name of a joint's counterpart: left for right and right for left."""
    for side, other in (SIDES, SIDES[::-1]):
        if name.startswith(f"{side}_"):
            return other + name.removeprefix(side)
    return name
