"""Asks vehicles for thumbnails that this server has missed: it came late, or a link was lost."""

from __future__ import annotations

import contextlib
import time
import uuid
from collections.abc import Callable
from typing import Any, Final

from panoexec.errors import LinkError
from panoexec.web.broker import BrokerLink
from panoexec.web.fleet import Fleet, unfolded

_AGAIN_S: Final = 20.0
"""The same vehicle is asked once in so long: its link may be a slow radio, and cameras may have no pictures."""

_EXPIRY_S: Final = 20


class Refill:
    """Asks when a vehicle is followed, and from time to time while it is."""

    def __init__(self, *, link: BrokerLink, fleet: Fleet, spawn: Callable[[Any], object]) -> None:
        """Describe it.

        Args:
            link: to the broker.
            fleet: the vehicles.
            spawn: starts a task that ends with the server.
        """
        self._link = link
        self._fleet = fleet
        self._spawn = spawn
        self._asked: dict[str, tuple[float, tuple[int, ...]]] = {}

    def look(self, vehicle_id: str) -> None:
        """Ask for what a page that follows this vehicle lacks, unless that was done lately."""
        missing = self._missing(vehicle_id)
        asked_s, asked = self._asked.get(vehicle_id, (-_AGAIN_S, ()))
        now = time.monotonic()
        if not missing or now - asked_s < _AGAIN_S or missing == asked:
            return  # what was asked for and did not come does not exist
        self._asked[vehicle_id] = now, missing
        self._spawn(self._ask(vehicle_id, missing))

    def link_lost(self) -> None:
        """What was asked for may have been lost."""
        self._asked.clear()

    def _missing(self, vehicle_id: str) -> tuple[int, ...]:
        vehicle = self._fleet.vehicles.get(vehicle_id)
        if vehicle is None or vehicle.mission is None or not self._link.up or vehicle.status == "offline":
            return ()
        shots = vehicle.mission.shots
        done = (index for index, mark in enumerate(unfolded(vehicle.state)) if mark in "dr")
        return tuple(index for index in done if shots.get(index, {}).get("url") is None)

    async def _ask(self, vehicle_id: str, shots: tuple[int, ...]) -> None:
        vehicle = self._fleet.vehicles[vehicle_id]
        if vehicle.mission is None or not vehicle.mission.id:
            return
        fields = {"transaction": f"panoexec-web/{uuid.uuid4().hex}", "mission_id": vehicle.mission.id}
        with contextlib.suppress(LinkError):
            await self._link.request(vehicle_id, "thumbnails", fields | {"shots": list(shots)}, expiry_s=_EXPIRY_S)
