"""The autopilots in software that tests may fly, each skipped unless its environment variable names the binary."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import pytest

from panoexec.dryrun import arducopter, px4
from panoexec.dryrun.autopilot import sitl_binary


@dataclass(frozen=True, slots=True, kw_only=True)
class Autopilot:
    """An autopilot, and what tests must know to meddle with its flight.

    Attributes:
        name: for test ids.
        variable: environment variable with the path of the binary.
        version: how its version begins.
        hold: base mode, main and sub mode (DO_SET_MODE) in which a mission may be flown.
        rtl: the same of the return to launch.
        land: the same of the landing.
        gps: parameter that takes the GPS away, its values without and with GPS, and whether it is an integer.
        locks: whether it leaves a lock file and a socket in /tmp.
    """

    name: str
    variable: str
    version: str
    hold: tuple[float, float, float]
    rtl: tuple[float, float, float]
    land: tuple[float, float, float]
    gps: tuple[str, float, float, bool]
    locks: bool

    def binary(self) -> Path:
        return sitl_binary(os.environ[self.variable])


ARDUCOPTER = Autopilot(
    name="ardupilot",
    variable=arducopter.BINARY_VARIABLE,
    version="4.",
    hold=(1, 4, 0),
    rtl=(1, 6, 0),
    land=(1, 9, 0),
    gps=("SIM_GPS1_ENABLE", 0, 1, False),
    locks=False,
)
PX4 = Autopilot(
    name="px4",
    variable=px4.BINARY_VARIABLE,
    version="1.",
    hold=(1, 4, 3),
    rtl=(1, 4, 5),
    land=(1, 4, 6),
    gps=("SIM_GPS_USED", 0, 10, True),
    locks=True,
)


def autopilots(*which: Autopilot) -> pytest.MarkDecorator:
    """Run a test for each of these autopilots whose binary is named."""
    return pytest.mark.parametrize(
        "autopilot",
        [
            pytest.param(
                one,
                id=one.name,
                marks=pytest.mark.skipif(
                    not os.environ.get(one.variable), reason=f"set {one.variable} to its SITL binary to run it"
                ),
            )
            for one in which or (ARDUCOPTER, PX4)
        ],
    )
