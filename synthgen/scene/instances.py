"""Who is who in the instance labels: subjects first, then what they wear, then occluders."""

from __future__ import annotations

from dataclasses import dataclass

from synthgen.models.joints import PART_OBJECT, PART_SLEEVE
from synthgen.scene.description import Scene


@dataclass(frozen=True)
class ObjectInstance:
    """One labelled object that is no hand.

    Attributes
    ----------
    instance_id : int
        1.. are the subjects; objects follow.
    part_id : int
        18 sleeve, 19 other object.
    kind : str
        ``sleeve``, ``ring``, ``bracelet``, ``watch``, or the shape of an occluder.
    subject : int
        Index of who wears it; -1 for occluders.
    place : int
        Which of the subject's bands, or row of ``scene.things``; -1 for sleeves.
    """

    instance_id: int
    part_id: int
    kind: str
    subject: int
    place: int


def objects_of(scene: Scene) -> tuple[ObjectInstance, ...]:
    """Return every labelled object of a scene, by instance id."""
    found: list[tuple[int, str, int, int]] = []
    for k, subject in enumerate(scene.subjects):
        if subject.sleeve is not None:
            found.append((PART_SLEEVE, "sleeve", k, -1))
        found += [(PART_OBJECT, band.kind, k, j) for j, band in enumerate(subject.bands)]
    found += [
        (PART_OBJECT, thing.shape, -1, j)
        for j, thing in enumerate(scene.things)
        if thing.role == "occluder"
    ]
    first = len(scene.subjects) + 1
    return tuple(ObjectInstance(first + n, *row) for n, row in enumerate(found))
