"""A panorama's place in a tour: a flight of the autopilot's own mission with panoramas at some of its waypoints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class TourStop:
    """A stop of a tour.

    Attributes:
        tour_id: of the tour.
        number: of the stop in it, from 1.
        waypoint: number of the waypoint in the autopilot's mission.
        modes: flight modes in which the panorama may be flown.
    """

    tour_id: str
    number: int
    waypoint: int
    modes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """As the mission's journal and manifest have it."""
        return {"tour_id": self.tour_id, "number": self.number, "waypoint": self.waypoint}


def stop_in(data: Mapping[str, Any]) -> dict[str, Any] | None:
    """The stop that the extra data of a mission's journal tell of, as the manifest has it; None without one."""
    told = data.get(TOUR)
    return dict(told) if isinstance(told, Mapping) else None


TOUR = "tour"
"""Extra data in the journal's head: the stop that the mission was flown at."""
