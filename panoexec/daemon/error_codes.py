"""The edge between the daemon's errors and MQTT: which code the answer to a request carries."""

from __future__ import annotations

from typing import Final

from panoexec.daemon.errors import (
    MissionBusyError,
    MissionStorageError,
    PlanningBudgetError,
    SupersededError,
    VehicleNotReadyError,
)
from panoexec.errors import PanoexecError, PlanningError, UsageError
from panoexec.mission.mission_requests import CommandRefusedError
from panoexec.mqtt.requests import ErrorCode, RefusedRequestError
from panoexec.store.session import NotResumableError

CODES: Final[dict[type[Exception], ErrorCode]] = {
    CommandRefusedError: "refused",
    SupersededError: "superseded",
    NotResumableError: "refused",
    MissionBusyError: "busy",
    VehicleNotReadyError: "not_ready",
    MissionStorageError: "storage",
    PlanningError: "planning",
    PlanningBudgetError: "planning_budget",
    UsageError: "invalid",
    PanoexecError: "device",
    Exception: "internal",
}
"""A class that is not listed has the code of its nearest base class."""


def refusal_of(error: Exception) -> RefusedRequestError:
    """The error as the answer to a request tells it.

    Args:
        error: whatever was raised while the request was handled. A `RefusedRequestError` is returned as it is, with the
            field that it names.
    """
    if isinstance(error, RefusedRequestError):
        return error
    code = next(CODES[kind] for kind in type(error).__mro__ if kind in CODES)
    return RefusedRequestError(code, f"{type(error).__name__}: {error}" if code == "internal" else str(error))
