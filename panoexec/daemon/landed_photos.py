"""Photos that had not reached this computer when their mission ended are brought after landing, while no mission flies.

A mission that begins ends this at once; it goes on afterwards, where it was. The files of the last missions are looked
for, the newest first, also after a restart.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Final

import structlog

from panoexec.daemon.camera_files import CameraFiles
from panoexec.daemon.missions import Missions
from panoexec.errors import PanoexecError
from panoexec.inputs.config import Config
from panoexec.mission.waiting import uncancelled
from panoexec.report.mission_outputs import restore_outputs
from panoexec.store.catalogue import catalogue
from panoexec.store.directory import MissionDirectory
from panoexec.store.landed_mission import LandedMission
from panoexec.store.photo_collector import PhotoCollector

_MISSIONS: Final = 10
"""How many of the last missions are looked at."""

_log = structlog.get_logger(__name__)


class LandedPhotos:
    """Runs as one task of the daemon."""

    def __init__(self, *, config: Callable[[], Config], missions: Missions, files: CameraFiles) -> None:
        """Describe it.

        Args:
            config: as of now.
            missions: which have priority.
            files: ways to bring files here.
        """
        self._config = config
        self._missions = missions
        self._files = files
        self._running: asyncio.Task[None] | None = None
        self._others_make_way = missions.make_way
        missions.make_way = self.make_way

    async def run(self) -> None:
        """Bring what is missing after each mission, and after the start."""
        while True:
            await self._missions.idle()
            running = self._running = asyncio.create_task(self._bring_all(), name="photos after landing")
            try:
                await asyncio.wait({running})
            finally:
                running.cancel()
                await asyncio.wait({running})
            if not running.cancelled() and (error := running.exception()) is not None:
                _log.error("photos could not be brought after landing", error=str(error))
            await self._files.close()  # its process is not needed before the next photo
            await self._missions.taken()

    async def make_way(self) -> None:
        """End it and return when it has given the journal back."""
        if (running := self._running) is not None and not running.done():
            running.cancel()
            await asyncio.wait({running})
        await self._others_make_way()

    async def _bring_all(self) -> None:
        stored = await asyncio.to_thread(catalogue, self._config().storage.path)
        for one in reversed(stored[-_MISSIONS:]):
            if not one.problem:
                try:
                    await self._bring(one.directory)
                except (PanoexecError, ValueError, OSError) as error:
                    _log.warning("photos not brought", mission_id=one.directory.mission_id, error=str(error))

    async def _bring(self, directory: MissionDirectory) -> None:
        landed = await asyncio.to_thread(LandedMission.read, directory)
        try:
            collector = PhotoCollector(
                directory.path, record=landed.record, store=landed.photos, fetchers=self._files.fetchers()
            )
            count = len(collector.remaining)
            if not count:
                return

            async def keep() -> None:
                await uncancelled(asyncio.create_task(self._keep(landed), name="keep photos"))

            _log.info("photos are brought after landing", mission_id=directory.mission_id, count=count)
            await collector.run_until_done(keep)
            for problem in sorted(set(collector.problems.values())):
                _log.warning("photo not brought", mission_id=directory.mission_id, problem=problem)
            async with self._missions.writing:
                await uncancelled(asyncio.create_task(asyncio.to_thread(restore_outputs, directory), name="outputs"))
        finally:
            landed.close()

    async def _keep(self, landed: LandedMission) -> None:
        async with self._missions.writing:
            events = await landed.flush()
        for event in events:
            self._missions.added(event)
