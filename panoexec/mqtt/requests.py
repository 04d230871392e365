"""Requests, read from bytes that a stranger may have sent (docs/contract.md).

They are read strictly: an unknown key, a text where a number belongs or a number that is not finite is an error that
names its field.
"""

from __future__ import annotations

import json
import re
from typing import Annotated, Any, ClassVar, Literal, Self, TypeAlias, cast

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError, field_validator, model_validator

from panoexec.errors import PanoexecError
from panoexec.inputs.plan_options import PlanOptions
from panoexec.inputs.validation import dotted, problem_lines

MAX_PAYLOAD = 64 * 1024
"""Bytes of a request, at most."""

MAX_SHOT = 100_000

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
    "storage",
    "device",
    "overload",
    "internal",
]
"""Why a request was not obeyed; docs/ground-station.md explains each."""

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
    """A request that is not obeyed, as the answer will say it.

    Attributes:
        code: for programs.
        message: for people; names the value and what would be accepted.
        field: dotted path of the field that is wrong, or None.
        transaction: of the request as far as it could be read, else None.
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
    """A JSON object; a key that it does not know is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Request(Payload):
    """What all requests have.

    Attributes:
        transaction: names the request; the same one twice gets the same answer and acts once.
    """

    command: ClassVar[str] = ""
    acts: ClassVar[bool] = True
    """Whether it changes anything: then its answer is kept across restarts."""

    transaction: Annotated[Any, Field(json_schema_extra=_TRANSACTION_SCHEMA)]

    @field_validator("transaction")
    @classmethod
    def _is_an_id(cls, value: object) -> Transaction:
        if not _is_transaction(value):
            raise ValueError("must be a text of 1 to 128 characters, or a whole number")
        return cast("Transaction", value)


class ToleranceFields(Payload):
    """Largest accepted pointing error of each axis, degrees; what is missing comes from the configuration."""

    pitch: ToleranceDeg | None = None
    roll: ToleranceDeg | None = None
    yaw: ToleranceDeg | None = None


class PlanRequest(Request):
    """Compute a plan, change nothing. What is missing comes from the configuration.

    Attributes:
        camera: name of a profile, or a table with a profile's keys.
        overlap: of neighbours, fraction of the image area; or `overlap_h` and `overlap_v`.
        elevation_deg: band to cover, [min, max].
        azimuth_deg: sector to cover, clockwise from min to max.
        tolerance_deg: pointing errors to survive.
        guarantee: what holds for every error: coverage, or the overlaps too.
        reference: what yaw 0 means: true north, or the vehicle's heading at the start.
        method: planner.
        order: of shooting.
        plan: a whole plan file instead of one to be computed.
    """

    command: ClassVar[str] = "plan"
    acts: ClassVar[bool] = False

    camera: Annotated[Any, Field(json_schema_extra=_CAMERA_SCHEMA)] = None
    overlap: Overlap | None = None
    overlap_h: Overlap | None = None
    overlap_v: Overlap | None = None
    elevation_deg: Pair | None = None
    azimuth_deg: Pair | None = None
    tolerance_deg: ToleranceFields | None = None
    guarantee: Literal["coverage", "all"] | None = None
    reference: Literal["north", "heading"] | None = None
    method: Literal["certified", "paper"] | None = None
    order: Literal["fastest", "rows", "columns", "nadir-first", "sky-first"] | None = None
    plan: Annotated[dict[str, Any], Strict()] | None = None

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
        if value is not None and not (-360 <= value[0] < value[1] <= 540 and value[1] - value[0] <= 360):
            raise ValueError(
                f"is [{value[0]:g}, {value[1]:g}]: must run clockwise from min to max, over at most 360°, "
                "within -360 to 540"
            )
        return value

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.overlap is not None and (self.overlap_h is not None or self.overlap_v is not None):
            raise ValueError("overlap and overlap_h, overlap_v exclude each other: give the one or the others")
        if self.plan is not None and (self.method is not None or self.order is not None):
            raise ValueError("a plan has its method and its order: leave out method and order, or the plan")
        return self

    def options(self) -> PlanOptions:
        """What it says of the panorama, but for the camera, whose profile is to be loaded."""
        tolerance = self.tolerance_deg or ToleranceFields()
        return PlanOptions(
            overlap=self.overlap,
            overlap_h=self.overlap_h,
            overlap_v=self.overlap_v,
            elevation_deg=_pair(self.elevation_deg),
            azimuth_deg=_pair(self.azimuth_deg),
            tolerance_pitch_deg=tolerance.pitch,
            tolerance_roll_deg=tolerance.roll,
            tolerance_yaw_deg=tolerance.yaw,
            guarantee=self.guarantee,
            method=self.method,
            order=self.order,
        )


class StartRequest(PlanRequest):
    """Fly a panorama: fields as for `plan`."""

    command: ClassVar[str] = "start"
    acts: ClassVar[bool] = True


class PauseRequest(Request):
    """Hold after the current photo until `resume`."""

    command: ClassVar[str] = "pause"
    reason: Text = ""


class ResumeRequest(Request):
    """Go on after a pause, or with the interrupted mission that the state offers."""

    command: ClassVar[str] = "resume"


class AbortRequest(Request):
    """End the mission for good."""

    command: ClassVar[str] = "abort"
    reason: Text = ""


class FinishRequest(Request):
    """End shooting and accept the gaps."""

    command: ClassVar[str] = "finish"
    reason: Text = ""


class SkipRequest(Request):
    """Leave a shot out; the current one if none is named."""

    command: ClassVar[str] = "skip"
    shot: ShotIndex | None = None


class RepeatRequest(Request):
    """Take a shot again; the last accepted one if none is named."""

    command: ClassVar[str] = "repeat"
    shot: ShotIndex | None = None


class GetRequest(Request):
    """Answer with the state, and publish state and plan anew."""

    command: ClassVar[str] = "get"
    acts: ClassVar[bool] = False


class SetProfileRequest(Request):
    """Use this camera from the next mission on, until it is set again; null goes back to the configuration's."""

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
        SetProfileRequest,
    )
}
"""The model of each command."""


def parse_request(command: str, payload: bytes, *, retained: bool = False, size: int | None = None) -> Request:
    """Read a request.

    Args:
        command: the last part of its topic.
        payload: as it came.
        retained: whether the broker had kept it: a command is an action and must not lie in wait.
        size: of the payload if that was cut off for its size.

    Raises:
        RefusedRequestError: it cannot be obeyed; the transaction is set as far as it could be read.
    """
    length = len(payload) if size is None else size
    if length > MAX_PAYLOAD:
        raise RefusedRequestError("too_large", f"the payload has {length} bytes: at most {MAX_PAYLOAD} are read")
    try:
        data = _parse_json(payload)
    except RefusedRequestError:
        _check_topic(command, retained=retained, transaction=None)
        raise
    sent = data.get("transaction")
    transaction = cast("Transaction", sent) if _is_transaction(sent) else None
    _check_topic(command, retained=retained, transaction=transaction)
    try:
        return REQUESTS[command].model_validate(data)
    except ValidationError as error:
        location = error.errors(include_url=False, include_input=False)[0]["loc"]
        raise RefusedRequestError(
            "invalid",
            "; ".join(problem_lines(error)[:10]),
            field=dotted(location) or None,
            transaction=transaction,
        ) from error


def _check_topic(command: str, *, retained: bool, transaction: Transaction | None) -> None:
    if command not in REQUESTS:
        raise RefusedRequestError(
            "unknown_command",
            f"there is no command {command[:40]!r}: commands are {', '.join(REQUESTS)}",
            transaction=transaction,
        )
    if retained:
        raise RefusedRequestError(
            "retained",
            "the request was published with the retain flag: it is refused, as it would act again whenever the vehicle "
            "connects; clear the topic and publish it without the flag",
            transaction=transaction,
        )


def _parse_json(payload: bytes) -> dict[str, Any]:
    try:
        text = payload.decode("utf-8")
        data = json.loads(text, object_pairs_hook=_unique, parse_constant=_no_constant)
    except UnicodeDecodeError as error:
        raise RefusedRequestError(
            "not_json", f"the payload is not UTF-8: byte {error.start}: {error.reason}"
        ) from error
    except RecursionError as error:
        raise RefusedRequestError("not_json", "the payload is nested too deeply") from error
    except ValueError as error:
        raise RefusedRequestError("not_json", f"the payload is not JSON: {str(error)[:200]}") from error
    if not isinstance(data, dict):
        raise RefusedRequestError("not_json", "the payload is not a JSON object")
    return data


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    data = dict(pairs)
    if len(data) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"key {twice[:40]!r} comes twice")
    return data


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON number")


def _is_transaction(value: object) -> bool:
    if isinstance(value, str):
        return 1 <= len(value) <= 128
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) < _LARGEST_INTEGER


def _pair(value: list[float] | None) -> tuple[float, float] | None:
    return None if value is None else (value[0], value[1])


def _camera(value: object) -> object:
    if value is None or isinstance(value, dict):
        return value
    # a name and never a path: strangers must not have files of the vehicle read
    if isinstance(value, str) and _PROFILE_NAME.fullmatch(value) and not value.endswith(".toml"):
        return value
    raise ValueError("must be the name of a camera profile, or a table with a profile's keys")
