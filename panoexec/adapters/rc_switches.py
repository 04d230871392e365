"""Switches of the pilot's transmitter that start and abort missions: RC_CHANNELS (65) of the autopilot.

A switch acts when it is moved, never by where it stands: it must have been low, then high. What a receiver without
signal puts out is never taken for the pilot's hand: many put out a preset, at once, while the autopilot finds out about
the loss by its own rules, and tells it in SYS_STATUS once a second. A switch therefore acts only when the autopilot
says a second later that its receiver works. While it does not, ArduPilot goes on sending the last pulses: they count
for nothing, so that a switch that stands high when the signal is back was not moved (found on ArduCopter's SITL).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Final

from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.message_hub import MavMessage
from panoexec.adapters.link.stream_health import Stream
from panoexec.adapters.link.stream_keeper import AUTOPILOT

RC_STREAM: Final = Stream(message_id=65, name="RC_CHANNELS", rate_hz=5.0, idle_rate_hz=5.0)
CHANNELS: Final = 18
LOW_US: Final = 1300
HIGH_US: Final = 1700
_VALID_US: Final = (900, 2200)
"""Pulses of receivers; 0 and 65535 are channels that do not exist."""
LOW_S: Final = 0.5
"""How long a switch must have been low before it counts."""
PROVEN_S: Final = 1.0
"""So long after a switch went high, the receiver must still work."""
STALE_S: Final = 1.0
_READINGS: Final = 3
_RC_RECEIVER: Final = 65536
"""MAV_SYS_STATUS_SENSOR_RC_RECEIVER."""


class Switch:
    """One switch; pure logic, times in seconds of one clock."""

    def __init__(self) -> None:
        self._low_since_s = math.nan
        self._high_since_s = math.nan
        self._readings = 0
        self._heard_s = -math.inf
        self._armed = False

    def forget(self) -> None:
        """What was seen says nothing about what comes: the switch must be low again first."""
        self._armed, self._readings = False, 0
        self._low_since_s = self._high_since_s = math.nan

    def read(self, pulse_us: int, now_s: float) -> None:
        """Take a reading of its channel."""
        if now_s - self._heard_s > STALE_S or not _VALID_US[0] <= pulse_us <= _VALID_US[1]:
            self.forget()
        self._heard_s = now_s
        if not _VALID_US[0] <= pulse_us <= _VALID_US[1]:
            return
        if pulse_us < LOW_US:
            self._high_since_s, self._readings = math.nan, 0
            if math.isnan(self._low_since_s):
                self._low_since_s = now_s
            self._armed |= now_s - self._low_since_s >= LOW_S
        elif pulse_us > HIGH_US:
            self._low_since_s = math.nan
            if math.isnan(self._high_since_s):
                self._high_since_s = now_s
            self._readings += 1
        else:
            self._low_since_s = self._high_since_s = math.nan
            self._readings = 0

    def works(self, now_s: float) -> bool:
        """The receiver works; whether the switch was moved, and acts now."""
        moved = self._armed and now_s - self._high_since_s >= PROVEN_S and self._readings >= _READINGS
        if not moved or now_s - self._heard_s > STALE_S:
            return False
        self.forget()
        return True


class RcSwitches:
    """The switches of one vehicle, while the link is open.

    Args:
        link: to the vehicle.
        actions: what each channel (from 1) does; called on the event loop.
    """

    def __init__(self, link: MavsdkLink, actions: Mapping[int, Callable[[], None]]) -> None:
        self._link = link
        self._actions = dict(actions)
        self._switches = {channel: Switch() for channel in actions}
        self._works = False
        self._offs = [link.on("RC_CHANNELS", self._channels), link.on("SYS_STATUS", self._status)]

    def close(self) -> None:
        """No switch acts any more."""
        for off in self._offs:
            off()

    def _channels(self, message: MavMessage) -> None:
        """In MAVSDK's thread, like `_status`."""
        if message.component_id == AUTOPILOT and self._works:
            for channel, switch in self._switches.items():
                switch.read(int(message.fields[f"chan{channel}_raw"]), time.monotonic())

    def _status(self, message: MavMessage) -> None:
        if message.component_id != AUTOPILOT:
            return
        present, enabled, health = (
            int(message.fields[f"onboard_control_sensors_{kind}"]) for kind in ("present", "enabled", "health")
        )
        self._works = bool(present & enabled & health & _RC_RECEIVER)
        for channel, switch in self._switches.items():
            if not self._works:
                switch.forget()
            elif switch.works(time.monotonic()):
                self._link.post(self._actions[channel])
