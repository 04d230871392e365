"""Each error of the daemon becomes one code of the MQTT contract."""

from __future__ import annotations

import pytest

from panoexec.daemon.error_codes import refusal_of
from panoexec.daemon.errors import MissionBusyError, MissionStorageError, VehicleNotReadyError
from panoexec.errors import (
    DeviceError,
    InputFileError,
    LinkError,
    MissionError,
    PanoexecError,
    PlanningError,
    UsageError,
)
from panoexec.mission.mission_requests import CommandRefusedError
from panoexec.mqtt.requests import RefusedRequestError
from panoexec.store.journal import JournalWriteError
from panoexec.store.session import NotResumableError


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (CommandRefusedError("m"), "refused"),
        (NotResumableError("m"), "refused"),
        (MissionBusyError("m"), "busy"),
        (VehicleNotReadyError("m"), "not_ready"),
        (MissionStorageError("m"), "storage"),
        (PlanningError("m"), "planning"),
        (UsageError("m"), "invalid"),
        (InputFileError("plan", ["m"]), "invalid"),
        (DeviceError("m"), "device"),
        (LinkError("m"), "device"),
        (MissionError("m"), "device"),
        (JournalWriteError("m"), "device"),
        (PanoexecError("m"), "device"),
    ],
)
def test_an_error_has_the_code_of_its_nearest_class_and_its_own_text(error: Exception, code: str) -> None:
    refused = refusal_of(error)
    assert (refused.code, refused.message, refused.field) == (code, str(error), None)


def test_what_nobody_raised_on_purpose_is_internal_and_tells_its_kind() -> None:
    refused = refusal_of(ZeroDivisionError("division by zero"))
    assert (refused.code, refused.message) == ("internal", "ZeroDivisionError: division by zero")


def test_a_refused_request_keeps_its_code_and_its_field() -> None:
    error = RefusedRequestError("conflict", "m", field="transaction", transaction=7)
    assert refusal_of(error) is error
