"""What can be wrong with a request to the daemon that is itself well formed."""

from __future__ import annotations

from panoexec.errors import DeviceError, MissionError


class MissionBusyError(MissionError):
    """A mission is under way, and there can be one at a time."""


class MissionStorageError(MissionError):
    """A new mission cannot be stored; nothing was begun."""


class VehicleNotReadyError(DeviceError):
    """Autopilot, gimbal or camera is missing; the message says which."""
