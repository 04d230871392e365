"""What slews teach: each is counted once, and only a pose that was held until its trigger counts as reached."""

from __future__ import annotations

import math
from typing import cast

import pytest

from panoexec.angles import rotation
from panoexec.mission.pointing.echo import EchoWatch
from panoexec.mission.pointing.poses import PoseReader, Reading
from panoexec.mission.slew_watch import SlewWatch
from panoexec.planning.model import Shot

SHOT = Shot(index=0, row=0, pitch_deg=-40.0, yaw_deg=90.0)


class Slew:
    """Readings of a slew from the horizon to the shot, and then to a pose of another station, pitch 5."""

    late_s, holds, interval_s = 0.0, False, 0.02

    def since(self, since_s: float) -> list[Reading]:
        times = [0.02 * i for i in range(-5, 200)]
        return [Reading(t, rotation(90.0, self._pitch_deg(t)), math.nan) for t in times if t > since_s]

    @staticmethod
    def _pitch_deg(time_s: float) -> float:
        there_deg = -40.0 * min(max(time_s - 0.05, 0.0), 1.0)
        return there_deg + 45.0 * min(max(time_s - 1.8, 0.0), 1.0)


def watching() -> SlewWatch:
    watch = SlewWatch(poses=cast(PoseReader, Slew()), echo=EchoWatch(""))
    watch.begins()
    return watch


def test_a_slew_counts_once_however_often_it_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    watch, seen = watching(), []
    slew = watch.echo.slew

    def counted(readings: list[Reading], **arguments: float) -> bool:
        seen.append(arguments["commanded_s"])
        return slew(readings, **arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(watch.echo, "slew", counted)
    watch.seen(SHOT, 0.0, yaw_follows=False)
    watch.seen(SHOT, 0.0, yaw_follows=False)
    assert watch.ended(SHOT, 0.0, settled=True, nose_since_s=None) == ""
    watch.seen(SHOT, 7.0, yaw_follows=False)
    assert seen == [0.0, 7.0]


def test_a_pose_that_settled_before_another_station_took_it_away_is_not_reached() -> None:
    watch = watching()
    assert "another station" in watch.ended(SHOT, 0.0, settled=False, nose_since_s=None)
    rest = watch.foreign._rest
    assert rest is not None
    watch.seen(SHOT, 0.0, yaw_follows=False)  # settled, while the camera's interval lasts
    assert watch.foreign._rest is rest
    assert "another station" in watch.ended(SHOT, 0.0, settled=False, nose_since_s=None)
    watch.ended(SHOT, 0.0, settled=True, nose_since_s=None)
    assert watch.foreign._rest is None
