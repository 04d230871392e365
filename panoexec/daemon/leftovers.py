"""What a mission leaves (manifest, exports, report) is written again where a process ended before it was complete."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import structlog

from panoexec.daemon.missions import Missions
from panoexec.errors import PanoexecError
from panoexec.report.mission_outputs import restore_outputs
from panoexec.store.catalogue import catalogue

_log = structlog.get_logger(__name__)


async def restore_leftovers(storage: Callable[[], Path], missions: Missions) -> None:
    """Go through the missions of the storage once, newest first, while none flies.

    Args:
        storage: the storage as configured now.
        missions: whose files are written by one task at a time.
    """
    for stored in reversed(await asyncio.to_thread(catalogue, storage())):
        directory, problem = stored.directory, stored.problem
        await missions.idle()  # processor and disk belong to the mission that flies
        if not problem:
            try:
                async with missions.writing:
                    if await asyncio.to_thread(restore_outputs, directory):
                        _log.warning("files of a mission were missing and written again", directory=str(directory.path))
                continue
            except (PanoexecError, ValueError, OSError) as error:
                problem = str(error)
        _log.error("a mission is damaged, see panoexec salvage", directory=str(directory.path), error=problem)
