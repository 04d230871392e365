"""MAVSDK's log and errors, converted to panoexec's."""

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
"""Texts for MAV_RESULT."""

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
    """Forwards MAVSDK's log to panoexec's: it would go to stdout, which is reserved for command output."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._logged: dict[str, float] = {}
        self._is_subscribed = False

    def subscribe(self) -> None:
        """Subscribe once in a process.

        MAVSDK's Python frees the trampoline of the earlier subscription before the library has the new one, and of two
        threads that subscribe at once the library may keep the one that is freed: its threads then call freed memory.
        """
        with self._lock:
            if not self._is_subscribed:
                mavsdk.log_subscribe(self)
                self._is_subscribed = True

    def __call__(self, level: LogLevel, message: str, file: str | None, line: int) -> bool:
        now = time.monotonic()
        with self._lock:
            repeated = now - self._logged.get(message, -_REPEAT_S) < _REPEAT_S
            if not repeated:
                if len(self._logged) > 200:
                    self._logged.clear()
                self._logged[message] = now
        if not repeated:
            log = _log.info if level >= LogLevel.WARN else _log.debug
            log(message, level_name=level.name, source=f"{file}:{line}")
        return True


_log_bridge = _LogBridge()


def quiet_mavsdk_log() -> None:
    """Forward MAVSDK's log to panoexec's; call this before any MAVSDK object is created, as often as you like."""
    _log_bridge.subscribe()


def device_error(what: str, error: MavsdkError, *, connected: bool) -> DeviceError:
    """Convert MAVSDK's error for a failed request.

    Args:
        what: the request, for messages: "pointing the gimbal".
        error: MAVSDK's; a plugin's error carries its result.
        connected: whether heartbeats arrive.
    """
    result = getattr(error, "result", None)
    name = result.name if result is not None else str(error)
    text = _TEXTS.get(name, name.lower().replace("_", " "))
    if not connected and name in _LINK_RESULTS:
        return LinkError(f"{what}: no link to the autopilot ({text})")
    return DeviceError(f"{what}: {text}")
