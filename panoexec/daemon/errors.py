"""What can be wrong with a request to the daemon that is itself well formed."""

from __future__ import annotations

from panoexec.errors import DeviceError, MissionError, PlanningError
from panoexec.mission.mission_requests import CommandRefusedError


class MissionBusyError(MissionError):
    """A mission is under way, and there can be one at a time."""


class MissionStorageError(MissionError):
    """A new mission, of which nothing was begun, or a command to one that ends because of it, cannot be stored."""


class VehicleNotReadyError(DeviceError):
    """Autopilot, gimbal or camera is missing; the message says which."""


class SupersededError(CommandRefusedError):
    """A later request took the place of this one; nothing was done."""


class PlanningBudgetError(PlanningError):
    """A plan needs more memory, processor time or images than the daemon grants; the message says which."""
