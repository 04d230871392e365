"""The verdict of the overlaps: whether a sharp pose outside tolerance serves the panorama all the same."""

from __future__ import annotations

from panoexec.mission.context import MissionContext
from panoexec.mission.log.events import MeasuredPose


async def overlaps_hold(flight: MissionContext, shot: int, measured: MeasuredPose | None) -> bool:
    """Whether the certificate holds with this pose as measured, if all that is to come goes as planned."""
    record = flight.record
    if measured is None:
        return False
    rotations, rows = record.measured(also=[*record.wanted(), (shot, measured)])
    return (await flight.verifier.certify(rotations, rows)).certified
