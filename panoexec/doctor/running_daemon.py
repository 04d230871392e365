"""Finds the daemon that uses the vehicle's link, and has it examine itself: two programs cannot share a link.

Signs of a daemon: the port or the serial device is in use, `status` is `online` at the broker, the service is active.
"""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Callable
from contextlib import aclosing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from panoexec.adapters.link.occupancy import occupant
from panoexec.adapters.link.serial_ports import connection_of
from panoexec.doctor.findings import Findings
from panoexec.errors import DeviceError, LinkError, PanoexecError
from panoexec.inputs.config import Config
from panoexec.mqtt.answers import DoctorFields
from panoexec.mqtt.ground_station import GroundStation

SERVICE_CONFIG: Final = Path("/etc/panoexec/config.toml")
"""The configuration of the systemd unit."""

_STATUS_S: Final = 1.5
_GET_S: Final = 4.0
_EXAMINE_S: Final = 120.0


@dataclass(frozen=True, slots=True, kw_only=True)
class DaemonSigns:
    """What speaks for a running daemon.

    Attributes:
        link: who uses the port or device, "" for nobody.
        status: the retained status at the broker: `online`, `offline`, or "" if it cannot be read.
        service: whether systemd says that the service is active.
    """

    link: str = ""
    status: str = ""
    service: bool = False

    @property
    def any(self) -> bool:
        """Whether there may be one."""
        return bool(self.link) or self.status == "online" or self.service

    @property
    def text(self) -> str:
        """The signs, for people."""
        parts = (
            self.link,
            "its status at the broker is online" if self.status == "online" else "",
            "the service panoexec is active" if self.service else "",
        )
        return ", ".join(part for part in parts if part)


async def look_for_daemon(config: Config, config_file: Path) -> DaemonSigns:
    """Look for a daemon that uses the link of this configuration; opens no link."""
    try:
        url = await asyncio.to_thread(connection_of, config.vehicle)
        link = await asyncio.to_thread(occupant, url)
    except LinkError:
        link = ""  # the checks tell
    return DaemonSigns(
        link=link, status=await _status(config), service=await _service() if _is_service(config_file) else False
    )


async def ask_daemon(config: Config, *, photo: bool, note: Callable[[str], None] = lambda _: None) -> Findings:
    """Have the daemon examine itself.

    Args:
        config: broker and vehicle id.
        photo: take one photo.
        note: receives progress messages for display.

    Raises:
        LinkError: there is no broker, or the daemon does not answer there.
        DeviceError: it refused; the text says why.
    """
    if config.mqtt.host is None:
        raise LinkError("it can be asked over a broker only: [mqtt] host is not set")
    async with GroundStation(config.mqtt) as ground:
        await ground.request(config.vehicle.id, "get", {}, timeout_s=_GET_S)  # whether anybody answers at all
        note("the daemon is running: it examines itself …")
        answer = await ground.request(config.vehicle.id, "doctor", {"photo": photo}, timeout_s=_EXAMINE_S)
    if answer.get("status") != "ok":
        error = answer.get("error") or {}
        raise DeviceError(f"the daemon refused the examination: {error.get('code')}: {error.get('message')}")
    return findings_of(answer.get("data"))


def findings_of(document: Any) -> Findings:
    """The findings that the `data` of an answer holds.

    Raises:
        DeviceError: it is not what a daemon of this version answers.
    """
    try:
        fields = DoctorFields.model_validate(document)
        return Findings.from_document(fields.model_dump())
    except (ValidationError, ValueError) as error:
        raise DeviceError(f"the daemon's answer is not understood (another version?): {str(error)[:200]}") from error


async def _status(config: Config) -> str:
    if config.mqtt.host is None:
        return ""
    try:
        async with (
            GroundStation(config.mqtt) as ground,
            asyncio.timeout(_STATUS_S),
            aclosing(ground.listen(config.vehicle.id)) as messages,
        ):
            async for message in messages:
                if message.kind == "status":
                    return str(message.document)
    except (PanoexecError, TimeoutError):
        pass
    return ""


def _is_service(config_file: Path) -> bool:
    return config_file.resolve() == SERVICE_CONFIG


async def _service() -> bool:
    program = shutil.which("systemctl")
    if program is None:
        return False
    process = await asyncio.create_subprocess_exec(
        *(program, "is-active", "--quiet", "panoexec.service"),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.DEVNULL,
    )
    return await process.wait() == 0
