"""A mission's reference frame: the origin that drift is measured from, and the direction of the plan's yaw 0.

A vehicle that has just connected may not have reported position and heading yet; they are set as soon as it does.
"""

from __future__ import annotations

import math

from panoexec.mission.context import MissionContext
from panoexec.mission.guards import distance_m
from panoexec.mission.log import events as ev


def update_reference_frame(context: MissionContext) -> None:
    """Set the origin and the reference yaw that are still unknown, if the vehicle reports them now."""
    record = context.record
    if record.origin_known and not math.isnan(record.reference_yaw_north_deg):
        return
    status = context.vehicle.status
    lacks_origin = not record.origin_known and not math.isnan(status.latitude_deg)
    lacks_heading = math.isnan(record.reference_yaw_north_deg) and not math.isnan(status.heading_deg)
    if not lacks_origin and not lacks_heading:
        return
    context.recorder.emit(
        ev.MissionAnchored(
            reference_yaw_north_deg=status.heading_deg if lacks_heading else record.reference_yaw_north_deg,
            latitude_deg=status.latitude_deg,
            longitude_deg=status.longitude_deg,
            altitude_m=status.altitude_m,
        )
    )
    if lacks_origin:
        warn_if_moved(context)


def warn_if_moved(context: MissionContext) -> None:
    """Warn if the vehicle has moved from where the mission began, possibly in an earlier process."""
    moved = distance_m(context.record.first_origin, context.vehicle.status)
    if moved > context.settings.guards.position_drift_m:
        text = f"resumed {moved:.1f} m from where the mission began: expect parallax on near objects"
        context.recorder.emit(ev.Warned(code="position", text=text))
