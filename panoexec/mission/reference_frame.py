"""Where a mission is tied down: the place that drift is measured from, and the direction of yaw 0.

A vehicle that has just been found may not have told them yet; they are taken as soon as it does.
"""

from __future__ import annotations

import math

from panoexec.mission.context import MissionContext
from panoexec.mission.guards import distance_m
from panoexec.mission.log import events as ev


def anchor(flight: MissionContext) -> None:
    """Take what this process still lacks and the vehicle tells by now."""
    record = flight.record
    if record.anchored and not math.isnan(record.reference_yaw_north_deg):
        return
    status = flight.vehicle.status
    lacks_place = not record.anchored and not math.isnan(status.latitude_deg)
    lacks_heading = math.isnan(record.reference_yaw_north_deg) and not math.isnan(status.heading_deg)
    if not lacks_place and not lacks_heading:
        return
    flight.recorder.emit(
        ev.MissionAnchored(
            reference_yaw_north_deg=status.heading_deg if lacks_heading else record.reference_yaw_north_deg,
            latitude_deg=status.latitude_deg,
            longitude_deg=status.longitude_deg,
            altitude_m=status.altitude_m,
        )
    )
    if lacks_place:
        tell_if_moved(flight)


def tell_if_moved(flight: MissionContext) -> None:
    """Warn if the vehicle is not where the first photos were taken, however many processes ago that was."""
    moved = distance_m(flight.record.first_origin, flight.vehicle.status)
    if moved > flight.settings.guards.position_drift_m:
        text = f"resumed {moved:.1f} m from where the mission began: expect parallax in near objects"
        flight.recorder.emit(ev.Warned(code="position", text=text))
