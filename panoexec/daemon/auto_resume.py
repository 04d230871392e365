"""What a daemon does by itself after a restart: restore its settings, and resume the mission that was interrupted."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Final

import structlog

from panoexec.daemon.beginnings import Beginning
from panoexec.daemon.commands import Commands
from panoexec.daemon.errors import MissionBusyError
from panoexec.daemon.leftovers import restore_leftovers
from panoexec.daemon.missions import Missions
from panoexec.daemon.vehicle_link import VehicleLink
from panoexec.inputs.config import Config
from panoexec.mission.mission_requests import CommandRefusedError
from panoexec.store.session import NotResumableError

_POLL_S: Final = 0.5

_log = structlog.get_logger(__name__)


class AutoResume:
    """Resumes as soon as the vehicle is there, unless somebody else did or called it off."""

    def __init__(
        self,
        *,
        config: Callable[[], Config],
        missions: Missions,
        vehicle: VehicleLink,
        commands: Commands,
        group: asyncio.TaskGroup,
    ) -> None:
        """Describe it.

        Args:
            config: as of now.
            missions: to be resumed.
            vehicle: with its devices.
            commands: whose settings are restored.
            group: of the daemon's tasks.
        """
        self._config = config
        self._missions = missions
        self._vehicle = vehicle
        self._commands = commands
        self._group = group

    async def storage_readable(self) -> None:
        """Restore what was set and what missions left, and resume an interrupted one if `[mission] resume` says so."""
        await self._commands.restore()
        if self._missions.busy:
            return
        may_resume = await self._missions.find_interrupted()
        await self._commands.decline_what_may_be_forgotten()
        restoring = restore_leftovers(lambda: self._config().storage.path, self._missions)
        self._group.create_task(restoring, name="leftovers")
        offer, config = self._missions.offer, self._config()
        if config.stations.enabled and offer is not None and offer.stop is not None:
            return  # it goes on if the vehicle is still at its station
        if may_resume and config.mission.resume == "auto":
            self._group.create_task(self._resume(), name="resume")

    async def _resume(self) -> None:
        while self._missions.offer is not None and await self._commands.stopping.may_auto_resume():
            devices = self._vehicle.devices
            if devices is not None and self._vehicle.links().autopilot.ok and not self._vehicle.doubt:
                try:
                    async with self._missions.claimed(Beginning("resume")):
                        await self._missions.go_on(devices)
                except (MissionBusyError, NotResumableError, CommandRefusedError) as error:
                    _log.warning("the interrupted mission cannot be resumed", error=str(error))
                return
            await asyncio.sleep(_POLL_S)
