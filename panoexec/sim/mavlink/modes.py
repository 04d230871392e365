"""Flight modes by name, with each autopilot's numbers in HEARTBEAT.custom_mode."""

from __future__ import annotations

from panoexec.sim.config import AutopilotKind
from panoexec.sim.mavlink.dialect import mavlink

_ARDUCOPTER = {
    "STABILIZE": 0,
    "ALT_HOLD": 2,
    "AUTO": 3,
    "GUIDED": 4,
    "LOITER": 5,
    "RTL": 6,
    "LAND": 9,
    "POSHOLD": 16,
    "BRAKE": 17,
}
# PX4: main mode in byte 2, sub mode in byte 3
_PX4 = {
    "MANUAL": 1 << 16,
    "ALTCTL": 2 << 16,
    "POSCTL": 3 << 16,
    "TAKEOFF": 4 << 16 | 2 << 24,
    "LOITER": 4 << 16 | 3 << 24,
    "MISSION": 4 << 16 | 4 << 24,
    "RTL": 4 << 16 | 5 << 24,
    "LAND": 4 << 16 | 6 << 24,
    "OFFBOARD": 6 << 16,
    "STABILIZED": 7 << 16,
}


class FlightModes:
    """The current flight mode and its encoding.

    Attributes:
        custom_mode: value of HEARTBEAT.custom_mode.
    """

    def __init__(self, autopilot: AutopilotKind) -> None:
        self._numbers = _ARDUCOPTER if autopilot == "ardupilot" else _PX4
        self._is_px4 = autopilot == "px4"
        self.custom_mode = self._numbers["LOITER" if self._is_px4 else "GUIDED"]

    def set(self, name: str) -> None:
        """Change to a mode by its name."""
        self.custom_mode = self._numbers[name]

    def set_from_command(self, main: float, sub: float) -> bool:
        """Set the mode by param2 and param3 of MAV_CMD_DO_SET_MODE; False if there is no such mode."""
        number = self._number(main, sub)
        if number not in self._numbers.values():
            return False
        self.custom_mode = number
        return True

    def is_auto_command(self, main: float, sub: float) -> bool:
        """Whether param2 and param3 of MAV_CMD_DO_SET_MODE mean the mode in which missions are flown."""
        return self._number(main, sub) == self._numbers["MISSION" if self._is_px4 else "AUTO"]

    def _number(self, main: float, sub: float) -> int:
        return int(main) << 16 | int(sub) << 24 if self._is_px4 else int(main)

    def base_mode(self, *, armed: bool) -> int:
        """Value of HEARTBEAT.base_mode."""
        mode = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        return int(mode | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0))

    @property
    def pilot_mode(self) -> str:
        """The mode of a pilot who takes over manually."""
        return "STABILIZED" if self._is_px4 else "STABILIZE"

    @property
    def boot_mode(self) -> str:
        """The mode after a boot: ArduPilot's INITIAL_MODE by default, PX4's Hold."""
        return "LOITER" if self._is_px4 else "STABILIZE"

    @property
    def land_mode(self) -> str:
        """The landing mode."""
        return "LAND"

    @property
    def is_guided(self) -> bool:
        """Whether a program controls the flight (GUIDED, OFFBOARD)."""
        return self.custom_mode == self._numbers["LOITER" if self._is_px4 else "GUIDED"]

    @property
    def is_auto(self) -> bool:
        """Whether the autopilot flies its mission (AUTO, Mission)."""
        return self.custom_mode == self._numbers["MISSION" if self._is_px4 else "AUTO"]

    @property
    def is_rtl(self) -> bool:
        """Whether the mode returns to the launch position."""
        return self.custom_mode == self._numbers["RTL"]

    @property
    def is_landing(self) -> bool:
        """Whether the mode lands at the current position."""
        return self.custom_mode == self._numbers[self.land_mode]
