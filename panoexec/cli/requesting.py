"""Requests of the command line to a vehicle, and what their answers mean: for `send` and the operator's verbs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from panoexec.cli.output import note
from panoexec.errors import UsageError
from panoexec.inputs.service_sections import MqttSection
from panoexec.mqtt.ground_station import GroundStation
from panoexec.mqtt.senders import CLI, this_user, transaction_of

_WRONG: Final = frozenset(
    {"too_large", "not_json", "unknown_command", "invalid", "conflict", "planning", "planning_budget"}
)
"""Codes of requests that can never be accepted as they are."""


async def ask(
    section: MqttSection, vehicle: str, command: str, fields: dict[str, Any], timeout_s: float
) -> dict[str, Any]:
    """The answer of a vehicle.

    Raises:
        LinkError: no broker, the vehicle is offline, or it did not answer.
    """
    fields = {"transaction": transaction_of(CLI, this_user())} | fields
    async with GroundStation(section) as ground:
        silent = f"no vehicle {vehicle} has been connected to this broker yet: waiting up to {timeout_s:g} s for it"
        return await ground.request(
            vehicle, command, fields, timeout_s=timeout_s, on_silence=lambda: note(silent) if timeout_s > 1 else None
        )


def exit_code(answer: dict[str, Any]) -> int:
    """0 accepted, 1 rejected, 2 an invalid request."""
    if answer["status"] == "ok":
        return 0
    return 2 if answer["error"]["code"] in _WRONG else 1


def report_error(answer: dict[str, Any], vehicle: str, command: str) -> None:
    """Say on stderr why a vehicle rejected a command."""
    note(f"panoexec: {error_text(answer, vehicle, command)}")


def error_text(answer: dict[str, Any], vehicle: str, command: str) -> str:
    """Why a vehicle rejected a command."""
    why = answer["error"]
    where = f" ({why['field']})" if why.get("field") else ""
    return f"{vehicle} rejected {command}: {why['code']}{where}: {why['message']}"


def plan_document(path: str | Path) -> Any:
    """The content of a plan file, for a request.

    Raises:
        UsageError: it cannot be read.
    """
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"--plan {path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise UsageError(f"--plan {path}: is not valid JSON: {error}") from error
