"""The dry-run on ArduPilot's and PX4's own software. Opt in: ARDUPILOT_SITL=/path/to/arducopter PX4_SITL=/path/to/px4
pytest tests/system/test_sitl.py

At twice real time; a machine that is busy with other things may not get that fast, and then a photo here and there is
rejected and taken again. What is asserted holds all the same.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from panoexec.sim.config import AirframeConfig
from panoexec.sim.ports import free_udp_ports
from tests.repository import ROOT
from tests.system import sitl_runs
from tests.system.dry_runs import accepted, dry_run, flown
from tests.system.sitl_kinds import ARDUCOPTER, Autopilot, autopilots
from tests.system.sitl_runs import (
    LONG_S,
    SMALL,
    TWO_AXES,
    WHOLE,
    Started,
    assert_true,
    in_the_middle,
    manifest_in,
    taken_in,
    truly_flown,
)

SPEEDUP = 2
STOPPED_S = 5.0
"""From the signal until nothing is left."""


def mission(autopilot: Autopilot, *arguments: str, output: Path) -> list[str]:
    return sitl_runs.mission("--sitl", str(autopilot.binary()), *arguments, speedup=SPEEDUP, output=output)


@contextlib.contextmanager
def whole_under_way(autopilot: Autopilot, output: Path) -> Iterator[Started]:
    arguments = mission(autopilot, *WHOLE, output=output)
    with in_the_middle(arguments, binary=autopilot.binary(), temporary=output) as started:
        yield started


def locks_of(autopilot: Autopilot, started: Started) -> list[Path]:
    """What PX4 keeps outside its folder, by the instance that its command line names."""
    if not autopilot.locks:
        return []
    words = started.living()[started.autopilot()].split()
    instance = words[words.index("-i") + 1]
    found = [Path(f"/tmp/px4_lock-{instance}"), Path(f"/tmp/px4-sock-{instance}")]
    assert any(path.exists() for path in found)
    return found


@autopilots()
def test_a_whole_panorama_in_wind_and_back_on_the_ground(autopilot: Autopilot, tmp_path: Path) -> None:
    summary = truly_flown(*mission(autopilot, *WHOLE, output=tmp_path))
    assert summary["uncovered_fraction"] == 0
    assert summary["vehicle"]["landed"] is True
    assert summary["vehicle"]["autopilot_version"].startswith(autopilot.version)
    # the best that a camera can say of each photo: a message of its own
    assert set(summary["evidence"]) <= {"capture_message", "file_seen"}
    assert sum(summary["evidence"].values()) == summary["shots"]
    manifest = manifest_in(tmp_path)
    home = AirframeConfig()
    for shot, attempt in zip(manifest["shots"], accepted(manifest), strict=True):
        assert abs(attempt["error_deg"]["pitch"]) <= 0.1
        assert abs(attempt["error_deg"]["roll"]) <= 0.1
        assert abs(attempt["error_deg"]["yaw"]) <= 0.7
        assert (Path(summary["directory"]) / shot["file"]).stat().st_size > 0
    position = manifest["position"]
    assert position["latitude_deg"] == pytest.approx(home.latitude_deg, abs=1e-4)
    assert position["longitude_deg"] == pytest.approx(home.longitude_deg, abs=1e-4)
    assert position["altitude_m"] == pytest.approx(home.home_altitude_m + 30.0, abs=3.0)


@autopilots()
def test_a_two_axis_gimbal_is_panned_by_the_vehicle(autopilot: Autopilot, tmp_path: Path) -> None:
    summary = truly_flown(*mission(autopilot, *TWO_AXES, output=tmp_path))
    manifest = manifest_in(tmp_path)
    assert summary["turns"] >= len({round(shot["target"]["yaw_deg"], 1) for shot in manifest["shots"]}) - 1
    for attempt in accepted(manifest):
        assert abs(attempt["error_deg"]["pitch"]) <= 0.1
        assert abs(attempt["error_deg"]["yaw"]) <= 2.0


@autopilots()
def test_the_vehicle_turns_where_a_gimbal_with_stops_does_not_reach(autopilot: Autopilot, tmp_path: Path) -> None:
    arguments = ("--yaw", "auto", "--gimbal-pan", "-40", "40", "--elevation", "-20", "20")
    summary = truly_flown(*mission(autopilot, *arguments, output=tmp_path))
    assert summary["turns"] >= 4
    assert abs(summary["worst"]["yaw_deg"]) <= 0.7


@autopilots(ARDUCOPTER)
def test_a_camera_on_a_servo_is_proven_by_its_count(autopilot: Autopilot, tmp_path: Path) -> None:
    summary = truly_flown(*mission(autopilot, "--trigger", "servo", *SMALL, output=tmp_path))
    assert summary["evidence"] == {"counted": summary["shots"]}
    # the payload exposes when the autopilot says that it has triggered; not every attempt comes to that
    assert summary["shots"] <= summary["photos"] <= summary["attempts"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@autopilots()
def test_a_signal_ends_everything_and_the_mission_goes_on_later(
    autopilot: Autopilot, number: signal.Signals, tmp_path: Path
) -> None:
    with whole_under_way(autopilot, tmp_path) as started:
        locks = locks_of(autopilot, started)
        began_s = time.monotonic()
        started.process.send_signal(number)
        assert started.process.wait(60) == 130
        started.assert_none_left(within_s=0.0)
        took_s = time.monotonic() - began_s
        print(f"{number.name}: {took_s:.1f} s until nothing was left")
        assert took_s <= STOPPED_S
    assert list(tmp_path.glob("panoexec-sitl-*")) == []
    assert not any(path.exists() for path in locks)
    (left,) = tmp_path.glob("missions/*")
    assert taken_in(tmp_path) >= 1
    assert_true(left)
    if number is signal.SIGINT:
        summary = flown("--resume", str(left), timeout_s=LONG_S)
        assert summary["vehicle"]["landed"] is True
        assert_true(left)


@autopilots()
def test_nothing_outlives_a_dry_run_that_is_killed(autopilot: Autopilot, tmp_path: Path) -> None:
    with whole_under_way(autopilot, tmp_path) as started:
        left = locks_of(autopilot, started)
        left += tmp_path.glob("panoexec-sitl-*")
        assert left
        started.process.send_signal(signal.SIGKILL)
        started.process.wait(10)
        # the renderer may have photos to finish
        started.assert_none_left(within_s=30.0)
    assert [path for path in left if path.exists()] == []


@autopilots()
def test_a_sitl_that_dies_ends_the_dry_run_with_its_name(autopilot: Autopilot, tmp_path: Path) -> None:
    with whole_under_way(autopilot, tmp_path) as started:
        os.kill(started.autopilot(), signal.SIGKILL)
        _, error = started.process.communicate(timeout=60)
        assert started.process.returncode == 3
        assert f"{autopilot.binary()} exited unexpectedly (signal 9)" in error.splitlines()[-1]
        started.assert_none_left(within_s=0.0)


@autopilots(ARDUCOPTER)
def test_a_vehicle_that_runs_already_is_neither_armed_nor_flown_nor_ended(autopilot: Autopilot, tmp_path: Path) -> None:
    ground_port, payload_port, rc_port, irlock_port = free_udp_ports(4)
    parameters = ROOT / "config" / "ardupilot-sitl.parm"
    with subprocess.Popen(
        [
            str(autopilot.binary()),
            *("--model", "+", "--wipe", "--speedup", str(SPEEDUP), "--defaults", str(parameters)),
            *("--home", "47.397742,8.545594,488,20", "--serial2", "none"),
            # ports that wait to be called, as sim_vehicle.py opens them
            *("--serial0", f"tcp:{ground_port}", "--serial1", f"tcp:{payload_port}"),
            *("--rc-in-port", str(rc_port), "--irlock-port", str(irlock_port)),
        ],
        cwd=tmp_path,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as sitl:
        try:
            connect = ("--sitl-connect", f"tcp:127.0.0.1:{ground_port}", "--attach", f"tcp:127.0.0.1:{payload_port}")
            done = dry_run(
                *sitl_runs.mission(*connect, *SMALL, speedup=SPEEDUP, output=tmp_path), "--json", timeout_s=LONG_S
            )
            assert done.returncode == 0, done.stderr
            assert "the vehicle is on the ground and stays there" in done.stderr
            summary = json.loads(done.stdout)
            assert summary["state"] == "complete"
            assert_true(Path(summary["directory"]))
            assert "landed" not in summary["vehicle"]
            assert sitl.poll() is None
        finally:
            sitl.terminate()
            sitl.wait(10)
