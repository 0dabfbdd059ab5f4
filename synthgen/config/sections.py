"""Building blocks of the schema: a strict frozen section, ranges and weights."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator


class Section(BaseModel):
    """A group of settings: frozen, unknown keys refused, nothing converted silently."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        strict=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
        validate_default=True,
    )


def _ascending(pair: tuple[float, float]) -> tuple[float, float]:
    low, high = pair
    if low > high:
        raise ValueError(f"the first number must not exceed the second, write [{high}, {low}]")
    return pair


_Fov = Annotated[float, Field(ge=5.0, le=120.0)]
_Fill = Annotated[float, Field(ge=0.1, le=1.2)]
_Unit = Annotated[float, Field(ge=0.0, le=1.0)]

FovRange = Annotated[tuple[_Fov, _Fov], AfterValidator(_ascending)]
FillRange = Annotated[tuple[_Fill, _Fill], AfterValidator(_ascending)]
UnitRange = Annotated[tuple[_Unit, _Unit], AfterValidator(_ascending)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
_Motion = Annotated[float, Field(ge=0.0, le=200.0)]
_Psf = Annotated[float, Field(ge=0.0, le=5.0)]
_Well = Annotated[float, Field(ge=0.0, le=1e7)]
_Jpeg = Annotated[int, Field(ge=0, le=100)]
MotionRange = Annotated[tuple[_Motion, _Motion], AfterValidator(_ascending)]
PsfRange = Annotated[tuple[_Psf, _Psf], AfterValidator(_ascending)]
WellRange = Annotated[tuple[_Well, _Well], AfterValidator(_ascending)]
JpegRange = Annotated[tuple[_Jpeg, _Jpeg], AfterValidator(_ascending)]
Weight = Annotated[float, Field(ge=0.0, le=1000.0)]


class Weighted(Section):
    """A choice: every field is the weight of the alternative of its name; their sum is free."""

    def weights(self) -> dict[str, float]:
        """Return the weights by name."""
        return {name: float(getattr(self, name)) for name in type(self).model_fields}

    @model_validator(mode="after")
    def _something_to_choose(self) -> Self:
        if sum(self.weights().values()) <= 0:
            names = ", ".join(self.weights())
            raise ValueError(f"every weight is 0; give one of {names} a positive weight")
        return self
