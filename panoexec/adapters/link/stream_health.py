"""The streams that a link expects, and when to request them again. Pure logic; times are real seconds, passed in."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

EKF_STATUS_REPORT: Final = 193
ESTIMATOR_STATUS: Final = 230
ARDUPILOT: Final = 3
PX4: Final = 12
"""MAV_AUTOPILOT, as in HEARTBEAT.autopilot."""

HEARTBEAT_LOST_S: Final = 3.0
"""Heartbeat timeout of the autopilot."""

_SILENT_S: Final = 1.0
_MAX_RETRY_S: Final = 10.0
_REFUSED_RETRY_S: Final = 30.0
_BOOT_BACK_S: Final = 1.0
_FUTURE_S: Final = 5.0
_FUTURE_KEPT_S: Final = 1.0
_HELD_UP_S: Final = 1.5
"""Messages that lag behind the others for so long, while none is as new as those before, are of a rebooted sender."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stream:
    """A message that is requested with MAV_CMD_SET_MESSAGE_INTERVAL (511).

    Attributes:
        message_id: MAVLink message id.
        name: MAVLink message name.
        rate_hz: rate while a mission runs.
        idle_rate_hz: rate otherwise, sufficient to monitor the sender.
        autopilot: the only MAV_AUTOPILOT that is asked for it, because others do not have it; None: every one.
    """

    message_id: int
    name: str
    rate_hz: float
    idle_rate_hz: float
    autopilot: int | None = None


POSITION: Final = "GLOBAL_POSITION_INT"
DEFAULT_STREAMS: Final = (
    Stream(message_id=285, name="GIMBAL_DEVICE_ATTITUDE_STATUS", rate_hz=50.0, idle_rate_hz=2.0),
    Stream(message_id=30, name="ATTITUDE", rate_hz=50.0, idle_rate_hz=2.0),
    Stream(message_id=281, name="GIMBAL_MANAGER_STATUS", rate_hz=2.0, idle_rate_hz=1.0),
    Stream(message_id=33, name=POSITION, rate_hz=5.0, idle_rate_hz=2.0),
    Stream(message_id=1, name="SYS_STATUS", rate_hz=1.0, idle_rate_hz=1.0),
    Stream(message_id=245, name="EXTENDED_SYS_STATE", rate_hz=1.0, idle_rate_hz=1.0),
    Stream(message_id=24, name="GPS_RAW_INT", rate_hz=5.0, idle_rate_hz=0.5),
    # ArduPilot announces each request for a message that it does not have on the pilot's screen
    Stream(message_id=EKF_STATUS_REPORT, name="EKF_STATUS_REPORT", rate_hz=2.0, idle_rate_hz=0.5, autopilot=ARDUPILOT),
    Stream(message_id=ESTIMATOR_STATUS, name="ESTIMATOR_STATUS", rate_hz=2.0, idle_rate_hz=0.5, autopilot=PX4),
)


class RebootDetector:
    """Detects reboots of the autopilot by the time since boot in its messages (`time_boot_ms`)."""

    def __init__(self) -> None:
        self.reboots = 0
        """How many were detected."""
        self._newest_s = -math.inf
        self._heard_s = math.inf
        self._received_s = -math.inf
        self._future_since_s = math.nan
        self._streams: dict[str, float] = {}
        self._ahead_s = -math.inf

    def note(self, boot_s: float, heard_s: float, received_s: float | None = None, *, stream: str = "") -> bool:
        """Take the time since boot of a message; True if the autopilot rebooted since the last message.

        Two signs: the time runs backwards by more than messages overtake each other, or the autopilot has been up for
        no longer than it was silent. The second one finds the reboot of an autopilot that had only just started: it
        forgets its message intervals, and when it is heard again it is already up for longer than before.

        A stream that is held up on its way lags behind the others, but never behind itself: its own time runs on.

        A time from the future is dropped: the true ones that follow it would look like a reboot. Only a sender that
        keeps to it for a second, with no message of the old time between, is believed.

        Args:
            boot_s: time since boot, seconds.
            heard_s: when the message arrived, monotonic seconds.
            received_s: when it arrived, on a clock that runs as fast as the vehicle's; None: `heard_s`.
            stream: name of the message.
        """
        if self._is_future(boot_s, heard_s, heard_s if received_s is None else received_s):
            return False
        silent_s = heard_s - self._heard_s
        self._heard_s = heard_s
        rebooted = boot_s <= silent_s
        if boot_s < self._newest_s - _BOOT_BACK_S:
            ran_back = boot_s < self._streams.get(stream, -math.inf) - _BOOT_BACK_S
            rebooted |= ran_back or heard_s - self._ahead_s > _HELD_UP_S
        else:
            self._ahead_s = heard_s
        if rebooted:
            self.reboots += 1
            self._streams.clear()
            self._ahead_s = heard_s
        self._streams[stream] = boot_s
        self._newest_s = boot_s if rebooted else max(self._newest_s, boot_s)
        return rebooted

    def _is_future(self, boot_s: float, heard_s: float, received_s: float) -> bool:
        passed_s = received_s - self._received_s  # infinite before the first message
        if boot_s - self._newest_s <= 2.0 * passed_s + _FUTURE_S or not math.isfinite(self._newest_s):
            self._received_s, self._future_since_s = received_s, math.nan
            return False
        if math.isnan(self._future_since_s):
            self._future_since_s = heard_s
        if heard_s - self._future_since_s < _FUTURE_KEPT_S:
            return True
        self._newest_s, self._received_s, self._future_since_s = boot_s, received_s, math.nan
        return False


class StreamHealth:
    """One stream: whether messages arrive, and when to request it (again).

    An autopilot loses all intervals when it reboots, and requests get lost on a bad link; so a granted stream that is
    silent is requested again, at growing intervals.
    """

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self.count = 0
        """Number of received messages; updated in MAVSDK's thread."""
        self.last_s = -math.inf
        """When the last message arrived."""
        self.refused = False
        """The autopilot refused the request."""
        self._asked_hz = 0.0
        self._next_ask_s = -math.inf
        self._delay_s = _SILENT_S

    def note(self, now_s: float) -> None:
        """Count a message; called in MAVSDK's thread."""
        self.count += 1
        self.last_s = now_s

    def forget(self) -> None:
        """The autopilot rebooted, or the link was lost: request the stream at once."""
        self._asked_hz = 0.0
        self._next_ask_s = -math.inf
        self._delay_s = _SILENT_S

    def due(self, wanted_hz: float, now_s: float) -> bool:
        """Whether to request `wanted_hz` now."""
        if wanted_hz != self._asked_hz and not self.refused:
            return now_s >= self._next_ask_s or self._asked_hz > 0
        silent = now_s - self.last_s > max(_SILENT_S, 5.0 / wanted_hz)
        return (silent or self.refused) and now_s >= self._next_ask_s

    def asked(self, wanted_hz: float, now_s: float, *, granted: bool | None) -> None:
        """Record the answer to a request.

        Args:
            wanted_hz: the requested rate.
            now_s: when the answer arrived.
            granted: None without an answer.
        """
        self.refused = granted is False
        self._asked_hz = wanted_hz if granted else 0.0
        self._next_ask_s = now_s + (_REFUSED_RETRY_S if self.refused else self._delay_s)
        self._delay_s = min(2 * self._delay_s, _MAX_RETRY_S)

    def settle(self, wanted_hz: float, now_s: float) -> None:
        """Reset the retry interval if messages arrive."""
        if now_s - self.last_s <= max(_SILENT_S, 5.0 / wanted_hz):
            self._delay_s = _SILENT_S
