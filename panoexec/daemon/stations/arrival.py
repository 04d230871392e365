"""Whether the vehicle has arrived at a station: near the waypoint, and at rest. Pure."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

from panoexec.daemon.stations.marked import Station, distance_to_m
from panoexec.devices import VehicleStatus

REST_S: Final = 0.4
"""For so long it must have been near and slow."""
REST_M_S: Final = 0.6
_KEPT_S: Final = 3.0


class Arrival:
    """Collects positions while a station's waypoint is the current item."""

    def __init__(self) -> None:
        self._waypoint = -1
        self._track: deque[tuple[float, VehicleStatus]] = deque()
        self._since_s = math.nan

    def forget(self) -> None:
        """The vehicle flies elsewhere."""
        self._waypoint, self._since_s = -1, math.nan
        self._track.clear()

    @property
    def since_s(self) -> float:
        """Since when it has been near, on the mission's clock: its hold time has begun by then, or later."""
        return self._since_s

    def there(self, station: Station, status: VehicleStatus, now_s: float, *, radius_m: float) -> bool:
        """Take the vehicle's status; whether it has arrived.

        Args:
            station: whose waypoint is the current item.
            status: of the vehicle.
            now_s: on the mission's clock.
            radius_m: how near is near.
        """
        if station.waypoint != self._waypoint:
            self.forget()
            self._waypoint = station.waypoint
        if not status.position_ok:
            self._since_s = math.nan
            self._track.clear()
            return False
        self._track.append((now_s, status))
        while self._track and now_s - self._track[0][0] > _KEPT_S:
            self._track.popleft()
        away_m = distance_to_m(status.latitude_deg, status.longitude_deg, (station.latitude_deg, station.longitude_deg))
        if not away_m <= radius_m:
            self._since_s = math.nan
            return False
        if math.isnan(self._since_s):
            self._since_s = now_s
        return now_s - self._since_s >= REST_S and self._speed_m_s(now_s) <= REST_M_S

    def _speed_m_s(self, now_s: float) -> float:
        """Mean speed over the last `REST_S`; infinity while that is not known."""
        past = [one for one in self._track if now_s - one[0] >= REST_S]
        if not past:
            return math.inf
        (then_s, then), (_, now) = past[-1], self._track[-1]
        way = distance_to_m(then.latitude_deg, then.longitude_deg, (now.latitude_deg, now.longitude_deg))
        climb = abs(now.relative_altitude_m - then.relative_altitude_m)
        return math.hypot(way, climb) / (now_s - then_s)
