"""What a link expects to hear, and when to ask for it again. Pure logic; times are real seconds, handed in."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

HEARTBEAT_LOST_S: Final = 3.0
"""Without a heartbeat of the autopilot for this long it counts as gone."""

_SILENT_S: Final = 1.0
_MAX_RETRY_S: Final = 10.0
_REFUSED_RETRY_S: Final = 30.0
_BOOT_BACK_S: Final = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Stream:
    """A message that must be asked for with MAV_CMD_SET_MESSAGE_INTERVAL (511).

    Attributes:
        message_id: MAVLink's number.
        name: MAVLink's name.
        rate_hz: wanted while a mission flies.
        idle_rate_hz: wanted otherwise; enough to know that it is there.
    """

    message_id: int
    name: str
    rate_hz: float
    idle_rate_hz: float


DEFAULT_STREAMS: Final = (
    Stream(message_id=285, name="GIMBAL_DEVICE_ATTITUDE_STATUS", rate_hz=50.0, idle_rate_hz=2.0),
    Stream(message_id=30, name="ATTITUDE", rate_hz=50.0, idle_rate_hz=2.0),
    Stream(message_id=281, name="GIMBAL_MANAGER_STATUS", rate_hz=2.0, idle_rate_hz=1.0),
    Stream(message_id=33, name="GLOBAL_POSITION_INT", rate_hz=5.0, idle_rate_hz=2.0),
    Stream(message_id=1, name="SYS_STATUS", rate_hz=1.0, idle_rate_hz=1.0),
    Stream(message_id=245, name="EXTENDED_SYS_STATE", rate_hz=1.0, idle_rate_hz=1.0),
    # of these two, ArduPilot has the first and PX4 the second
    Stream(message_id=193, name="EKF_STATUS_REPORT", rate_hz=1.0, idle_rate_hz=0.5),
    Stream(message_id=230, name="ESTIMATOR_STATUS", rate_hz=1.0, idle_rate_hz=0.5),
)


class RebootDetector:
    """Notices reboots of the autopilot: its boot time runs backwards."""

    def __init__(self) -> None:
        self.reboots = 0
        """How many were noticed."""
        self._newest_s = -math.inf

    def note(self, boot_s: float) -> bool:
        """Take the boot time of a message; True if the autopilot rebooted since the last one.

        Messages overtake each other by less than a second, so that much backwards is no reboot.
        """
        rebooted = boot_s < self._newest_s - _BOOT_BACK_S
        if rebooted:
            self.reboots += 1
        self._newest_s = boot_s if rebooted else max(self._newest_s, boot_s)
        return rebooted


class StreamHealth:
    """One stream: whether it flows, and whether to ask for it (again).

    An autopilot forgets all intervals when it reboots and loses requests on a bad link; so what was granted but is
    silent is asked for again, with growing patience.
    """

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self.count = 0
        """Messages that arrived; counted in the vendor's thread."""
        self.last_s = -math.inf
        """When the last one arrived."""
        self.refused = False
        """The autopilot said that it cannot."""
        self._asked_hz = 0.0
        self._next_ask_s = -math.inf
        self._delay_s = _SILENT_S

    def note(self, now_s: float) -> None:
        """A message arrived; in the vendor's thread."""
        self.count += 1
        self.last_s = now_s

    def forget(self) -> None:
        """The autopilot rebooted, or the link was away: ask at once."""
        self._asked_hz = 0.0
        self._next_ask_s = -math.inf
        self._delay_s = _SILENT_S

    def due(self, wanted_hz: float, now_s: float) -> bool:
        """Whether to ask for `wanted_hz` now."""
        if wanted_hz != self._asked_hz and not self.refused:
            return now_s >= self._next_ask_s or self._asked_hz > 0
        silent = now_s - self.last_s > max(_SILENT_S, 5.0 / wanted_hz)
        return (silent or self.refused) and now_s >= self._next_ask_s

    def asked(self, wanted_hz: float, now_s: float, *, granted: bool | None) -> None:
        """Note the answer to a request.

        Args:
            wanted_hz: what was asked for.
            now_s: when the answer came.
            granted: None if there was no answer.
        """
        self.refused = granted is False
        self._asked_hz = wanted_hz if granted else 0.0
        self._next_ask_s = now_s + (_REFUSED_RETRY_S if self.refused else self._delay_s)
        self._delay_s = min(2 * self._delay_s, _MAX_RETRY_S)

    def settle(self, wanted_hz: float, now_s: float) -> None:
        """Forget past trouble if it flows."""
        if now_s - self.last_s <= max(_SILENT_S, 5.0 / wanted_hz):
            self._delay_s = _SILENT_S
