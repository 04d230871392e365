"""The model of each request (docs/contract.md).

The models are strict: an unknown key, a string instead of a number, or a number that is not finite is an error that
names its field.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, ClassVar, Literal, Self, TypeAlias, cast

from pydantic import BaseModel, ConfigDict, Field, Strict, field_validator, model_validator

from panoexec.azimuths import azimuth_range
from panoexec.errors import PanoexecError
from panoexec.inputs.plan_options import PlanOptions, SkylineField
from panoexec.inputs.skyline import skyline_of
from panoexec.planning.search.budget import MOST_BUDGET_S

MAX_PAYLOAD = 64 * 1024
"""Maximum size of a request in bytes."""

MAX_SHOT = 100_000

STOPPING = frozenset({"abort", "finish", "pause"})
"""Commands that stop the vehicle: executed on arrival, before all other requests that wait, on any load and disk."""

MOVING = frozenset({"resume", "start"})
"""Commands that can set the vehicle in motion: a stopping command also stops those that arrived before it."""

ErrorCode: TypeAlias = Literal[
    "too_large",
    "not_json",
    "unknown_command",
    "retained",
    "invalid",
    "expired",
    "conflict",
    "interrupted",
    "busy",
    "refused",
    "not_ready",
    "planning",
    "planning_budget",
    "superseded",
    "storage",
    "device",
    "overload",
    "internal",
]
"""Why a request was rejected or failed; docs/ground-station.md explains each code."""

Transaction: TypeAlias = str | int

Finite: TypeAlias = Annotated[float, Strict(), Field(allow_inf_nan=False)]
Overlap: TypeAlias = Annotated[Finite, Field(ge=0, lt=1)]
ToleranceDeg: TypeAlias = Annotated[Finite, Field(ge=0, le=45)]
Pair: TypeAlias = Annotated[list[Finite], Field(min_length=2, max_length=2)]
Text: TypeAlias = Annotated[str, Strict(), Field(max_length=200)]
ShotIndex: TypeAlias = Annotated[int, Strict(), Field(ge=0, lt=MAX_SHOT)]

_TRANSACTION_SCHEMA = {"anyOf": [{"type": "string", "minLength": 1, "maxLength": 128}, {"type": "integer"}]}
_CAMERA_SCHEMA = {"anyOf": [{"type": "string", "minLength": 1}, {"type": "object"}]}
_PROFILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}")
_LARGEST_INTEGER = 2**63


class RefusedRequestError(PanoexecError):
    """A request that is rejected, with the error of the response.

    Attributes:
        code: machine-readable code.
        message: text that names the value and what is accepted.
        field: dotted path of the invalid field, or None.
        transaction: transaction of the request if it could be parsed, otherwise None.
    """

    def __init__(
        self, code: ErrorCode, message: str, *, field: str | None = None, transaction: Transaction | None = None
    ) -> None:
        self.code = code
        self.message = message
        self.field = field
        self.transaction = transaction
        super().__init__(message)


class Payload(BaseModel):
    """A JSON object; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Request(Payload):
    """The common fields of all requests.

    Attributes:
        transaction: id of the request; a repeated request gets the same response and is executed once.
    """

    command: ClassVar[str] = ""
    acts: ClassVar[bool] = True
    """Whether the request has an effect; its response is then kept across restarts."""

    transaction: Annotated[Any, Field(json_schema_extra=_TRANSACTION_SCHEMA)]

    @field_validator("transaction")
    @classmethod
    def _is_an_id(cls, value: object) -> Transaction:
        if not is_transaction(value):
            raise ValueError("must be a string of 1 to 128 characters, or an integer")
        return cast("Transaction", value)


class ToleranceFields(Payload):
    """Maximum pointing error of each axis, degrees; missing values are taken from the configuration."""

    pitch: ToleranceDeg | None = None
    roll: ToleranceDeg | None = None
    yaw: ToleranceDeg | None = None


class PlanRequest(Request):
    """Compute a plan without flying it. Missing fields are taken from the configuration.

    Attributes:
        camera: name of a profile, or a table with the keys of a profile.
        lens: which lens of the camera counts; that of the configuration or the plan, else calibrated where it is known.
        overlap: overlap of neighbouring images, fraction of the image area; or `overlap_h` and `overlap_v`.
        elevation_deg: elevation range to cover, [min, max].
        azimuth_deg: azimuth range to cover, clockwise from min to max.
        tolerance_deg: maximum pointing errors.
        guarantee: conditions that hold for all errors within tolerance: coverage only, or also the overlaps.
        textured_below: where the sky begins, which ties no images: an elevation, or [azimuth, elevation] pairs.
        reference: direction of yaw 0: true north, or the vehicle's heading at the start.
        method: planning method.
        order: shooting order.
        budget_s: processor time of the search, which then ends with the best plan so far.
        plan: a plan file instead of a plan to be computed.
        preset: whose fields are taken where the request has none: `[presets.NAME]` of the configuration.
        shots: whether the answer has the whole plan file, too.
    """

    command: ClassVar[str] = "plan"
    acts: ClassVar[bool] = False

    camera: Annotated[Any, Field(json_schema_extra=_CAMERA_SCHEMA)] = None
    lens: Literal["calibrated", "nominal"] | None = None
    overlap: Overlap | None = None
    overlap_h: Overlap | None = None
    overlap_v: Overlap | None = None
    elevation_deg: Pair | None = None
    azimuth_deg: Pair | None = None
    tolerance_deg: ToleranceFields | None = None
    guarantee: Literal["coverage", "all"] | None = None
    textured_below: SkylineField | None = None
    reference: Literal["north", "heading"] | None = None
    method: Literal["certified", "paper"] | None = None
    order: Literal["fastest", "rows", "columns", "nadir-first", "sky-first"] | None = None
    budget_s: Annotated[Finite, Field(gt=0, le=MOST_BUDGET_S)] | None = None
    plan: Annotated[dict[str, Any], Strict()] | None = None
    preset: Annotated[str, Strict(), Field(min_length=1, max_length=40)] | None = None
    shots: Annotated[bool, Strict()] = False

    @field_validator("camera")
    @classmethod
    def _is_a_camera(cls, value: object) -> object:
        return _camera(value)

    @field_validator("elevation_deg")
    @classmethod
    def _is_a_band(cls, value: list[float] | None) -> list[float] | None:
        if value is not None and not -90 <= value[0] < value[1] <= 90:
            raise ValueError(f"is [{value[0]:g}, {value[1]:g}]: must be [min, max] with -90 ≤ min < max ≤ 90")
        return value

    @field_validator("azimuth_deg")
    @classmethod
    def _is_a_sector(cls, value: list[float] | None) -> list[float] | None:
        if value is not None:
            azimuth_range(*value)
        return value

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.overlap is not None and (self.overlap_h is not None or self.overlap_v is not None):
            raise ValueError(
                "overlap and overlap_h, overlap_v exclude each other: give overlap, or overlap_h and overlap_v"
            )
        own = (self.method, self.order, self.budget_s)
        if self.plan is not None and any(value is not None for value in own):
            raise ValueError("a plan includes its method and order: omit method, order and budget_s, or omit the plan")
        return self

    def options(self) -> PlanOptions:
        """What it says of the panorama, but for the camera, whose profile is to be loaded."""
        tolerance = self.tolerance_deg or ToleranceFields()
        return PlanOptions(
            lens=self.lens,
            overlap=self.overlap,
            overlap_h=self.overlap_h,
            overlap_v=self.overlap_v,
            elevation_deg=_pair(self.elevation_deg),
            azimuth_deg=_pair(self.azimuth_deg),
            tolerance_pitch_deg=tolerance.pitch,
            tolerance_roll_deg=tolerance.roll,
            tolerance_yaw_deg=tolerance.yaw,
            guarantee=self.guarantee,
            textured_below=None if self.textured_below is None else skyline_of(self.textured_below),
            method=self.method,
            order=self.order,
            budget_s=self.budget_s,
        )


class StartRequest(PlanRequest):
    """Start a mission; the fields of `plan`, and its name.

    Attributes:
        name: for people: in the state, the manifest, the report and the list of missions.
    """

    command: ClassVar[str] = "start"
    acts: ClassVar[bool] = True

    name: Annotated[str, Strict(), Field(max_length=80)] = ""

    @field_validator("name")
    @classmethod
    def _is_one_line(cls, value: str) -> str:
        if not value.isprintable():
            raise ValueError("must be one line of printable characters")
        return value.strip()


class StopRequest(Request):
    """The fields of `pause`, `finish` and `abort`, the `STOPPING` commands."""

    reason: Text = ""


class PauseRequest(StopRequest):
    """Hold after the current photo until `resume`."""

    command: ClassVar[str] = "pause"


class ResumeRequest(Request):
    """Continue after a pause, or resume the interrupted mission that the state shows as `resumable`."""

    command: ClassVar[str] = "resume"


class AbortRequest(StopRequest):
    """End the mission permanently."""

    command: ClassVar[str] = "abort"


class FinishRequest(StopRequest):
    """End shooting and accept the gaps."""

    command: ClassVar[str] = "finish"


class SkipRequest(Request):
    """Skip a shot; the current one if `shot` is missing."""

    command: ClassVar[str] = "skip"
    shot: ShotIndex | None = None


class RepeatRequest(Request):
    """Retake a shot; the last accepted one if `shot` is missing."""

    command: ClassVar[str] = "repeat"
    shot: ShotIndex | None = None


class GetRequest(Request):
    """Return the state, and publish state and plan again."""

    command: ClassVar[str] = "get"
    acts: ClassVar[bool] = False


class MissionsRequest(Request):
    """Return the newest missions of the storage: id, name, state, shots, photos present, size.

    Attributes:
        newest: how many.
    """

    command: ClassVar[str] = "missions"
    acts: ClassVar[bool] = False

    newest: Annotated[int, Strict(), Field(ge=1, le=50)] = 10


class PresetsRequest(Request):
    """Return the presets of the configuration."""

    command: ClassVar[str] = "presets"
    acts: ClassVar[bool] = False


class ThumbnailsRequest(Request):
    """Publish thumbnails again.

    Attributes:
        mission_id: whose; the current or last mission if it is missing.
        shots: which; all that there are if it is missing.
    """

    command: ClassVar[str] = "thumbnails"
    acts: ClassVar[bool] = False

    mission_id: Annotated[str, Strict(), Field(pattern=r"^\d{8}T\d{6}\.\d{3}Z$")] | None = None
    shots: Annotated[list[ShotIndex], Field(max_length=10_000)] | None = None


class DoctorRequest(Request):
    """Examine link, rates, gimbal, camera, broker and computer; nothing moves.

    While a mission is under way, only what cannot disturb it is examined. A mission that begins ends the examination
    with the error `busy`.

    Attributes:
        photo: take three photos and report what proves them; not while a mission is under way.
    """

    command: ClassVar[str] = "doctor"
    acts: ClassVar[bool] = False
    photo: Annotated[bool, Strict()] = False


class SetProfileRequest(Request):
    """Set the camera of the following missions; null: the configured camera."""

    command: ClassVar[str] = "set_profile"
    camera: Annotated[Any, Field(json_schema_extra={"anyOf": [*_CAMERA_SCHEMA["anyOf"], {"type": "null"}]})]

    @field_validator("camera")
    @classmethod
    def _is_a_camera(cls, value: object) -> object:
        return _camera(value)


REQUESTS: dict[str, type[Request]] = {
    model.command: model
    for model in (
        PlanRequest,
        StartRequest,
        PauseRequest,
        ResumeRequest,
        AbortRequest,
        FinishRequest,
        SkipRequest,
        RepeatRequest,
        GetRequest,
        DoctorRequest,
        MissionsRequest,
        PresetsRequest,
        ThumbnailsRequest,
        SetProfileRequest,
    )
}
"""The request model of each command."""


def is_transaction(value: object) -> bool:
    """Whether the value can be the transaction of a request."""
    if isinstance(value, str):
        return 1 <= len(value) <= 128
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) < _LARGEST_INTEGER


def _pair(value: list[float] | None) -> tuple[float, float] | None:
    return None if value is None else (value[0], value[1])


def _camera(value: object) -> object:
    if value is None or isinstance(value, dict):
        return value
    # a name, never a path: requests must not cause files of the vehicle to be read
    if isinstance(value, str) and _PROFILE_NAME.fullmatch(value) and not value.endswith(".toml"):
        return value
    raise ValueError("must be the name of a camera profile, or a table with the keys of a profile")
