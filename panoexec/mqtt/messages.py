"""What the vehicle says over MQTT (docs/contract.md): answers and the state, as models and as bytes.

`asyncapi.yaml` is generated from these models and from those of the requests (`panoexec.mqtt.requests`).
"""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from panoexec.mission.log.states import MissionState
from panoexec.mqtt.requests import ErrorCode, Payload, RefusedRequestError, Transaction


class ErrorFields(Payload):
    """Why a request was not obeyed."""

    code: ErrorCode
    message: str
    field: str | None = None


class Response(Payload):
    """The answer to a request."""

    transaction: Transaction | None
    status: Literal["ok", "error"]
    error: ErrorFields | None = None
    data: dict[str, Any] | None = None


class LinkFields(Payload):
    """How a link does: whether it works, and seconds since something was heard (null: never)."""

    ok: bool
    age_s: Annotated[float, Field(ge=0)] | None


class LinksFields(Payload):
    """The links of the vehicle."""

    autopilot: LinkFields
    gimbal: LinkFields
    camera: LinkFields


class State(Payload):
    """The retained state of the daemon and its mission.

    Attributes:
        state: of the mission; `idle` without one.
        mission_id: the mission that the other fields tell of; null without one.
        shots_total, shots_done, attempts, retakes: counts.
        shots: where each shot stands, in the order of their indices, equal neighbours together, for example
            `d12 r1 c1 t42`: d done, r done by a retake, c being taken, a to be taken again, m missing (given up or left
            out), t to do; empty without a mission.
        current: index of the shot that is being taken.
        eta_s: seconds until shooting is over.
        reason: why it is in this state, for people.
        resumable: mission that `resume` would go on with.
        battery_frac: 0 to 1, null if unknown.
        boot_id: of this process; seq counts states within it.
        time: ISO 8601 UTC.
    """

    state: MissionState
    mission_id: str | None
    shots_total: int
    shots_done: int
    attempts: int
    retakes: int
    shots: str
    current: int | None
    eta_s: float | None
    reason: str
    resumable: str | None
    link: LinksFields
    battery_frac: float | None
    boot_id: str
    seq: int
    time: str


def dump(model: BaseModel) -> bytes:
    """A payload as bytes of JSON, ASCII, so that whatever a stranger sent can be echoed."""
    return dump_json(model.model_dump(mode="python"))


def dump_json(document: Any) -> bytes:
    """A document as bytes of JSON."""
    return json.dumps(document, separators=(",", ":"), allow_nan=False).encode("ascii")


def ok(transaction: Transaction | None, data: dict[str, Any] | None = None) -> Response:
    """The answer to a request that was obeyed."""
    return Response(transaction=transaction, status="ok", data=data if data is not None else {})


def failed(error: RefusedRequestError, transaction: Transaction | None = None) -> Response:
    """The answer to a request that was not."""
    known = transaction if transaction is not None else error.transaction
    fields = ErrorFields(code=error.code, message=error.message, field=error.field)
    return Response(transaction=known, status="error", error=fields)
