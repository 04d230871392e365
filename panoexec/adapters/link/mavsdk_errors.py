"""What all adapters to MAVSDK share: its log, and its errors turned into ours."""

from __future__ import annotations

import threading
import time
from typing import Final

import mavsdk
import structlog
from mavsdk import LogLevel, MavsdkError

from panoexec.errors import DeviceError, LinkError

_log = structlog.get_logger("mavsdk")
_REPEAT_S: Final = 30.0

MAV_RESULTS: Final[dict[int, str]] = {
    0: "accepted",
    1: "temporarily rejected",
    2: "denied",
    3: "not supported",
    4: "failed",
    5: "in progress",
    6: "cancelled",
}
"""MAV_RESULT, in words."""

_TEXTS: Final[dict[str, str]] = {
    "TIMEOUT": "not answered",
    "NO_SYSTEM": "there is no autopilot",
    "CONNECTION_ERROR": "could not be sent",
    "UNSUPPORTED": "not supported",
    "ACTION_UNSUPPORTED": "not supported",
    "PROTOCOL_UNSUPPORTED": "not supported",
    "INVALID_ARGUMENT": "there is no such device",
    "CAMERA_ID_INVALID": "there is no such device",
}
_LINK_RESULTS: Final = frozenset({"TIMEOUT", "NO_SYSTEM", "CONNECTION_ERROR"})


class _LogBridge:
    """MAVSDK prints its log to stdout, which belongs to the answer of a command; so it goes to our log instead."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._logged: dict[str, float] = {}

    def __call__(self, level: LogLevel, message: str, file: str | None, line: int) -> bool:
        now = time.monotonic()
        with self._lock:
            repeated = now - self._logged.get(message, -_REPEAT_S) < _REPEAT_S
            if not repeated:
                if len(self._logged) > 200:
                    self._logged.clear()
                self._logged[message] = now
        if not repeated:
            say = _log.info if level >= LogLevel.WARN else _log.debug
            say(message, level_name=level.name, source=f"{file}:{line}")
        return True


_log_bridge = _LogBridge()


def quiet_mavsdk_log() -> None:
    """Send MAVSDK's log to ours; to be called before anything of it is created."""
    mavsdk.log_subscribe(_log_bridge)


def device_error(what: str, error: MavsdkError, *, connected: bool) -> DeviceError:
    """Our error for a failed request.

    Args:
        what: the request, in words: "pointing the gimbal".
        error: MAVSDK's; a plugin's error carries its result.
        connected: whether heartbeats arrive.
    """
    result = getattr(error, "result", None)
    name = result.name if result is not None else str(error)
    words = _TEXTS.get(name, name.lower().replace("_", " "))
    if not connected and name in _LINK_RESULTS:
        return LinkError(f"{what}: no link to the autopilot ({words})")
    return DeviceError(f"{what}: {words}")
