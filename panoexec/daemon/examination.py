"""The daemon examines itself: the doctor's checks on the daemon's own link, while it runs.

A second program on the same link would take the daemon's messages away, or be told that the port is in use. A mission
has priority: while one is under way, only what cannot disturb it is examined, and one that begins ends the examination.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from panoexec.adapters.linked_vehicle import LinkedVehicle
from panoexec.daemon.errors import MissionBusyError
from panoexec.daemon.missions import Missions
from panoexec.daemon.planner import plan_apart
from panoexec.daemon.vehicle_link import VehicleLink
from panoexec.doctor.findings import Findings
from panoexec.doctor.run_checks import check_surroundings
from panoexec.doctor.vehicle import examine_vehicle
from panoexec.errors import LinkError
from panoexec.inputs.config import Config

_PATIENCE_S: Final = 5.0
"""The daemon has looked for its devices long before: what is not there yet is missing."""


class Examination:
    """Runs one examination at a time."""

    def __init__(
        self, *, config: Callable[[], Config], config_file: Path, missions: Missions, vehicle: VehicleLink
    ) -> None:
        """Describe it.

        Args:
            config: as of now.
            config_file: its file, for the advice of the checks.
            missions: which have priority.
            vehicle: with the open link.
        """
        self._config = config
        self._config_file = config_file
        self._missions = missions
        self._vehicle = vehicle
        self._running: asyncio.Task[Findings] | None = None
        self._ended = False
        missions.make_way = self.make_way

    async def run(self, *, photo: bool) -> dict[str, Any]:
        """Examine; the document of the findings.

        Args:
            photo: take one photo, unless a mission is under way.

        Raises:
            MissionBusyError: an examination runs already, or a mission began meanwhile.
        """
        if self._running is not None:
            raise MissionBusyError("the daemon is being examined already: wait for that answer")
        self._ended = False
        running = self._running = asyncio.create_task(
            self._examine(photo=photo, in_use=self._missions.busy), name="examination"
        )
        try:
            return (await running).document()
        except asyncio.CancelledError:
            if not self._ended:
                raise
            raise MissionBusyError("a mission began, which ended the examination: ask again while it flies") from None
        finally:
            self._running = None
            running.cancel()

    async def make_way(self) -> None:
        """End the running examination and return when it has given the devices back."""
        running = self._running
        if running is not None:
            self._ended = True
            running.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.wait({running})

    async def _examine(self, *, photo: bool, in_use: bool) -> Findings:
        config, findings = self._config(), Findings()
        findings.examined_by = "daemon"
        linked = self._vehicle.linked
        if linked is None:
            told = self._vehicle.lacking or "the link is closed"
            findings.missing("link", "port", told, advice="[vehicle] serial or connection")
        else:
            await self._examine_vehicle(linked, config, findings, photo=photo, in_use=in_use)
        during = " while a mission is under way" if in_use else ""
        findings.note("link", "examined by", f"the running daemon, on its own link{during}")
        if linked is not None and self._vehicle.lacking:
            findings.missing("link", "daemon", self._vehicle.lacking, needed="a vehicle that is ready")
        await check_surroundings(config, self._config_file, findings)
        return findings

    async def _examine_vehicle(
        self, linked: LinkedVehicle, config: Config, findings: Findings, *, photo: bool, in_use: bool
    ) -> None:
        try:
            await examine_vehicle(
                linked,
                config,
                findings,
                patience_s=_PATIENCE_S,
                photo=photo,
                camera=self._vehicle.camera,
                planner=plan_apart,
                in_use=in_use,
            )
        except LinkError as error:  # it was closed meanwhile
            findings.missing("link", "port", str(error), advice="[vehicle] serial or connection")
