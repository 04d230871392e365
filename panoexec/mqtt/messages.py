"""Messages of the vehicle over MQTT (docs/contract.md): responses and the state, as models and as bytes.

`asyncapi.yaml` is generated from these models and from the request models (`panoexec.mqtt.requests`).
"""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from panoexec.mission.log.states import MissionState
from panoexec.mqtt.requests import ErrorCode, Payload, RefusedRequestError, Transaction


class ErrorFields(Payload):
    """Why a request was rejected or failed."""

    code: ErrorCode
    message: str
    field: str | None = None


class Response(Payload):
    """The response to a request."""

    transaction: Transaction | None
    status: Literal["ok", "error"]
    error: ErrorFields | None = None
    data: dict[str, Any] | None = None


class LinkFields(Payload):
    """Status of a link: whether it works, and seconds since the last message (null: never)."""

    ok: bool
    age_s: Annotated[float, Field(ge=0)] | None


class LinksFields(Payload):
    """The links of the vehicle."""

    autopilot: LinkFields
    gimbal: LinkFields
    camera: LinkFields


class ErrorDegFields(Payload):
    """Pointing error about the axes of the gimbal."""

    pitch: float
    roll: float
    yaw: float


class PoseFields(Payload):
    """Where the camera points, in the plan's frame; `error_deg` to the current shot, null between shots."""

    pitch_deg: float
    roll_deg: float
    yaw_deg: float
    error_deg: ErrorDegFields | None


class TourFields(Payload):
    """Stations of the autopilot's mission.

    Attributes:
        tour_id: of the flight with panoramas at them; null before the first.
        stations: how many the mission has.
        waypoint: number of the waypoint at which one is flown; null between them.
        done: how many were complete.
        skipped: how many were not, for whatever reason.
        text: what goes on, for people.
    """

    tour_id: str | None
    stations: int
    waypoint: int | None
    done: int
    skipped: int
    text: str


class State(Payload):
    """The retained state of the daemon and its mission.

    Attributes:
        state: state of the mission; `idle` without one.
        mission_id: id of the mission that the other fields describe; null without one.
        name: what people call it; empty for none.
        reference: direction of the plan's yaw 0: `north`, or `heading` at the start; null without a mission.
        shots_total, shots_done, attempts, retakes: counts.
        shots: status of each shot in the order of the indices, with equal neighbours combined, for example
            `d12 r1 c1 t42`: d done, r done after a retake, c current, a to be retaken, m missing (given up or skipped),
            t pending; empty without a mission.
        content: accepted photos by what their content proves (`ok`, `blurred`, …); empty while nothing was examined.
        current: index of the current shot.
        eta_s: estimated seconds until the end of shooting.
        reason: why the mission is in this state, as text.
        resumable: id of the mission that `resume` would resume.
        pose: where the camera points now; null without a mission under way, or if it is not known.
        battery_frac: state of charge, 0 to 1; null if unknown.
        battery_need_frac: part of a full battery that the rest of the shooting needs; null if unknown.
        tour: stations of the autopilot's mission; null without any.
        boot_id: id of the process; `seq` counts states within it.
        time: ISO 8601 UTC.
    """

    state: MissionState
    mission_id: str | None
    name: str
    reference: str | None = None
    shots_total: int
    shots_done: int
    attempts: int
    retakes: int
    shots: str
    content: dict[str, int] = Field(default_factory=dict)
    current: int | None
    eta_s: float | None
    reason: str
    resumable: str | None
    link: LinksFields
    pose: PoseFields | None = None
    battery_frac: float | None
    battery_need_frac: float | None = None
    tour: TourFields | None = None
    boot_id: str
    seq: int
    time: str


class StateDelta(Payload):
    """The difference of a state from an earlier one, sent on slow links in place of most whole states.

    Attributes:
        boot_id: as in both states.
        base: `seq` of the whole state that it builds on.
        patch: JSON merge patch (RFC 7386); a member that it removes is null in the state, and missing in `content`.
    """

    boot_id: str
    base: int
    patch: dict[str, Any]


def dump(model: BaseModel) -> bytes:
    """A payload as ASCII JSON bytes, so that any received text can be echoed."""
    return dump_json(model.model_dump(mode="python"))


def dump_json(document: Any) -> bytes:
    """A document as ASCII JSON bytes."""
    return json.dumps(document, separators=(",", ":"), allow_nan=False).encode("ascii")


def ok(transaction: Transaction | None, data: dict[str, Any] | None = None) -> Response:
    """The response to a request that was executed."""
    return Response(transaction=transaction, status="ok", data=data if data is not None else {})


def failed(error: RefusedRequestError, transaction: Transaction | None = None) -> Response:
    """The response to a request that was rejected or failed."""
    known = transaction if transaction is not None else error.transaction
    fields = ErrorFields(code=error.code, message=error.message, field=error.field)
    return Response(transaction=known, status="error", error=fields)
