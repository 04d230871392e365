"""A mission with each kind of gimbal: refused with its cause, or complete with the gimbal that is meant.

`PANOEXEC_ALL_FAULTS=1` flies one mission for every kind instead of a few.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

pytest.importorskip("pymavlink")

from panoexec.sim.gimbal_kinds import GIMBAL_KINDS
from tests.system.dry_runs import dry_run
from tests.system.kind_missions import TOLERANCE, Flown, Payload, fly

STUCK = "gimbal-stuck=t0+9999"
FLOWN = {
    # kind: fault, autopilot, component that tells the attitude
    "mavlink": ("", "", 154),
    "siyi": ("drift=1.0,x4", "", 1),
    "gremsy": ("", "", 154),
    "own-manager": ("", "", 154),
    "two": ("", "", 154),
    "ten-hertz": ("drift=1.0,x3", "", 154),
    "asked": ("", "px4", 154),
    "north-off": ("", "", 154),
}
REFUSED = {
    # kind: fault, autopilot, cause
    "echo": (STUCK, "px4", "MNT_MODE_OUT = 0"),
    "echo-untold": (STUCK, "", "ms in its reports, which no gimbal can do"),
    "echo-device": ("", "", "ms in its reports, which no gimbal can do"),
    "servo": ("", "", "MNT1_TYPE = 1"),
    "stranger": ("attitude-stop=2+300", "", "the gimbal has sent no attitude"),
}
ALL = "PANOEXEC_ALL_FAULTS" in os.environ
"""Whether all are flown, or a few."""


async def mission(tmp_path: Path, kind: str, fault: str, autopilot: str) -> Flown:
    flown = await fly(tmp_path, Payload(gimbal=kind, fault=fault, autopilot=autopilot))
    assert flown.untrue == []
    return flown


def test_every_kind_is_flown_or_refused() -> None:
    assert {*FLOWN, *REFUSED} == set(GIMBAL_KINDS)


@pytest.mark.parametrize("kind", FLOWN if ALL else ("north-off",))
async def test_a_gimbal_that_measures_completes(tmp_path: Path, kind: str) -> None:
    fault, autopilot, device = FLOWN[kind]
    manifest = (await mission(tmp_path, kind, fault, autopilot)).manifest
    assert manifest["state"] == "complete", manifest["reason"]
    assert manifest["gimbal"]["device"] == device
    if kind == "north-off":
        assert manifest["gimbal"]["north_off_deg"] == pytest.approx(60, abs=0.5)
        assert any("the gimbal's north is +60" in text for text in manifest["warnings"])


@pytest.mark.parametrize("kind", REFUSED if ALL else ("echo-untold",))
async def test_a_gimbal_that_does_not_measure_is_refused(tmp_path: Path, kind: str) -> None:
    fault, autopilot, why = REFUSED[kind]
    manifest = (await mission(tmp_path, kind, fault, autopilot)).manifest
    assert manifest["state"] == "failed"
    assert why in manifest["reason"]
    if kind != "stranger":
        assert manifest["counts"]["shots_done"] == 0


@pytest.mark.skipif(not ALL, reason="PANOEXEC_ALL_FAULTS=1 flies it")
async def test_a_tolerance_is_refused_to_a_gimbal_that_cannot_hold_it(tmp_path: Path) -> None:
    flown = await fly(tmp_path, Payload(gimbal="siyi"), tolerance=TOLERANCE)
    assert flown.summary.state == "failed"
    assert "comes to rest with a steady error of pitch +0.3" in flown.summary.reason
    assert "it cannot hold tolerance_pitch_deg = 0.25" in flown.summary.reason


def test_an_unknown_kind_lists_those_that_there_are() -> None:
    done = dry_run("--camera", "dji-x5s-15mm", "--gimbal-kind", "dji")
    assert done.returncode == 2
    assert "--gimbal-kind dji: no such kind; there are mavlink, siyi, gremsy" in done.stderr
    small = ("--camera", "dji-x5s-15mm", "--elevation", "-15", "5", "--method", "paper")
    assert "needs --autopilot ardupilot" in dry_run("--gimbal-kind", "servo", "--autopilot", "px4", *small).stderr
