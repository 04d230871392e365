"""The tour that is flown, kept on disk at each change."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from panoexec.clock import Clock
from panoexec.daemon.stations.marked import Station
from panoexec.mission.log.states import MissionState
from panoexec.store.catalogue import glance
from panoexec.store.directory import mission_directories
from panoexec.store.journal import JournalFileError
from panoexec.store.tours import Stop, Tour, new_tour_id, newest_tour, write_tour


class TourLog:
    """The current tour.

    Args:
        storage: returns the storage folder.
        vehicle: returns the vehicle's id.
        clock: of missions.

    Attributes:
        tour: the current one; None between tours.
    """

    def __init__(self, *, storage: Callable[[], Path], vehicle: Callable[[], str], clock: Clock) -> None:
        self.tour: Tour | None = None
        self._storage = storage
        self._vehicle = vehicle
        self._clock = clock
        self._looked = False

    @property
    def tour_id(self) -> str:
        """Of the current tour; "" without one."""
        return "" if self.tour is None else self.tour.tour_id

    async def of_mission(self, digest: str, waypoints: tuple[int, ...]) -> Tour:
        """The current tour; one that an earlier process left under way goes on, if the mission is the same.

        Raises:
            UsageError: it cannot be written.
        """
        if self.tour is None and not self._looked:
            left = await asyncio.to_thread(newest_tour, self._storage())
            if left is not None and not left.ended and (left.digest, left.vehicle) == (digest, self._vehicle()):
                self.tour = left
        self._looked = True
        if self.tour is None or self.tour.digest != digest:
            tour_id = new_tour_id(self._storage(), now_utc_s=self._clock.time())
            await self._keep(Tour(tour_id=tour_id, vehicle=self._vehicle(), digest=digest, waypoints=waypoints))
        assert self.tour is not None
        return self.tour

    async def begin_stop(self, station: Station) -> Stop:
        """A new stop of the tour.

        Raises:
            UsageError: it cannot be written.
        """
        assert self.tour is not None
        stop = Stop(
            number=len(self.tour.stops) + 1,
            waypoint=station.waypoint,
            preset=station.preset,
            latitude_deg=station.latitude_deg,
            longitude_deg=station.longitude_deg,
            arrived=self._now(),
        )
        await self.note(stop)
        return stop

    async def note(self, stop: Stop) -> None:
        """Keep what became of a stop so far.

        Raises:
            UsageError: it cannot be written.
        """
        if self.tour is not None:
            await self._keep(self.tour.with_stop(stop))

    async def close(self, stop: Stop, *, outcome: str, reason: str) -> None:
        """A stop is over.

        Raises:
            UsageError: it cannot be written.
        """
        await self.note(replace(stop, outcome=outcome, reason=reason, left=self._now()))

    async def state_of(self, mission_id: str | None) -> MissionState | None:
        """The state of a mission on disk; None without one, and while its journal is in use."""
        directory = next((one for one in mission_directories(self._storage()) if one.mission_id == mission_id), None)
        if directory is None:
            return None
        try:
            return (await asyncio.to_thread(glance, directory.journal)).state
        except JournalFileError:
            return None

    async def end(self) -> None:
        """The tour is over.

        Raises:
            UsageError: it cannot be written.
        """
        if self.tour is not None:
            tour, self.tour = self.tour, None
            await asyncio.to_thread(write_tour, self._storage(), replace(tour, ended=True))

    async def _keep(self, tour: Tour) -> None:
        await asyncio.to_thread(write_tour, self._storage(), tour)
        self.tour = tour  # told when it is on disk

    def _now(self) -> str:
        moment = datetime.fromtimestamp(self._clock.time(), UTC)
        return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")
