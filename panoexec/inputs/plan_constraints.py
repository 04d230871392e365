"""The constraints in a plan file: how they are read and checked, written, and described as JSON Schema."""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, Strict, field_validator

from panoexec.planning.model import AngleBox, Band, Constraints, Tolerance

_NUMBER: Final = {"type": "number"}
_PAIR: Final = {"type": "array", "items": _NUMBER, "minItems": 2, "maxItems": 2}

# strict: a text or a truth value where a number belongs is a mistake in the program that wrote it
Finite: TypeAlias = Annotated[float, Strict(), Field(allow_inf_nan=False)]
Overlap: TypeAlias = Annotated[Finite, Field(ge=0, lt=1)]
Degrees: TypeAlias = Annotated[Finite, Field(ge=-720, le=720)]
Elevation: TypeAlias = Annotated[Finite, Field(ge=-90, le=90)]
AxisTolerance: TypeAlias = Annotated[Finite, Field(ge=0, lt=90)]


class PlanFileModel(BaseModel):
    """A part of a plan file: unknown keys are ignored."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class _ToleranceModel(PlanFileModel):
    pitch: AxisTolerance
    roll: AxisTolerance
    yaw: AxisTolerance


class _MaskModel(PlanFileModel):
    elevation_deg: tuple[Elevation, Elevation]
    azimuth_deg: tuple[Degrees, Degrees]


class ConstraintsModel(PlanFileModel):
    """`constraints` of a plan file, checked."""

    overlap_h: Overlap
    overlap_v: Overlap
    elevation_deg: tuple[Elevation, Elevation]
    azimuth_deg: tuple[Degrees, Degrees] = (-180.0, 180.0)
    tolerance_deg: _ToleranceModel
    guarantee: Literal["coverage", "all"] = "coverage"
    masks: Annotated[tuple[_MaskModel, ...], Field(max_length=1000)] = ()

    @field_validator("elevation_deg")
    @classmethod
    def _not_upside_down(cls, value: tuple[float, float]) -> tuple[float, float]:
        if not value[0] < value[1]:
            raise ValueError(f"[{value[0]:g}, {value[1]:g}] is upside down or empty: the lower end comes first")
        return value

    @field_validator("azimuth_deg")
    @classmethod
    def _a_sector(cls, value: tuple[float, float]) -> tuple[float, float]:
        if not 0 < value[1] - value[0] <= 360:
            raise ValueError(f"[{value[0]:g}, {value[1]:g}] must run clockwise over more than 0 and at most 360°")
        return value

    def constraints(self) -> Constraints:
        """The same as the planner has it."""
        return Constraints(
            overlap_h=self.overlap_h,
            overlap_v=self.overlap_v,
            band=Band(
                elevation_min_deg=self.elevation_deg[0],
                elevation_max_deg=self.elevation_deg[1],
                azimuth_min_deg=self.azimuth_deg[0],
                azimuth_max_deg=self.azimuth_deg[1],
            ),
            tolerance=Tolerance(
                pitch_deg=self.tolerance_deg.pitch, roll_deg=self.tolerance_deg.roll, yaw_deg=self.tolerance_deg.yaw
            ),
            guarantee=self.guarantee,
            masks=tuple(
                AngleBox(
                    elevation_min_deg=mask.elevation_deg[0],
                    elevation_max_deg=mask.elevation_deg[1],
                    azimuth_min_deg=mask.azimuth_deg[0],
                    azimuth_max_deg=mask.azimuth_deg[1],
                )
                for mask in self.masks
            ),
        )


def constraints_to_data(constraints: Constraints) -> dict[str, Any]:
    """Constraints as plan files show them; what the gimbal can do is left out, as it belongs to the vehicle."""
    band = constraints.band
    return {
        "overlap_h": constraints.overlap_h,
        "overlap_v": constraints.overlap_v,
        "elevation_deg": [band.elevation_min_deg, band.elevation_max_deg],
        "azimuth_deg": [band.azimuth_min_deg, band.azimuth_max_deg],
        "tolerance_deg": {
            "pitch": constraints.tolerance.pitch_deg,
            "roll": constraints.tolerance.roll_deg,
            "yaw": constraints.tolerance.yaw_deg,
        },
        "guarantee": constraints.guarantee,
        "masks": [
            {
                "elevation_deg": [mask.elevation_min_deg, mask.elevation_max_deg],
                "azimuth_deg": [mask.azimuth_min_deg, mask.azimuth_max_deg],
            }
            for mask in constraints.masks
        ],
    }


def constraints_schema() -> dict[str, Any]:
    """The JSON Schema of what `constraints_to_data` writes."""
    return _object(
        {
            "overlap_h": _NUMBER,
            "overlap_v": _NUMBER,
            "elevation_deg": _PAIR,
            "azimuth_deg": _PAIR,
            "tolerance_deg": _object({"pitch": _NUMBER, "roll": _NUMBER, "yaw": _NUMBER}),
            "guarantee": {"enum": ["coverage", "all"]},
            "masks": {"type": "array", "items": _object({"elevation_deg": _PAIR, "azimuth_deg": _PAIR})},
        }
    )


def _object(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": list(properties)}
