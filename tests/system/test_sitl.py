"""The dry-run on ArduPilot's own software. Opt in: ARDUPILOT_SITL=/path/to/arducopter pytest tests/system/test_sitl.py

At five times real time; a machine that is busy with other things may not get that fast, and then a photo here and there
is rejected and taken again. What is asserted holds all the same.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from panoexec.dryrun.arducopter import BINARY_VARIABLE
from panoexec.dryrun.autopilot import sitl_binary
from panoexec.dryrun.firmware import free_udp_ports
from panoexec.sim.config import AirframeConfig
from tests.repository import ROOT
from tests.system import sitl_runs
from tests.system.dry_runs import accepted, dry_run, flown
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

SPEEDUP = 5

pytestmark = pytest.mark.skipif(
    not os.environ.get(BINARY_VARIABLE), reason=f"set {BINARY_VARIABLE} to an ArduCopter SITL binary to run it"
)


def mission(*arguments: str, output: Path) -> list[str]:
    return sitl_runs.mission(*arguments, speedup=SPEEDUP, output=output)


@contextlib.contextmanager
def whole_under_way(output: Path) -> Iterator[Started]:
    arguments = mission("--sitl", *WHOLE, output=output)
    with in_the_middle(arguments, binary=sitl_binary(None), temporary=output) as started:
        yield started


def test_a_whole_panorama_in_wind_and_back_on_the_ground(tmp_path: Path) -> None:
    summary = truly_flown(*mission("--sitl", *WHOLE, output=tmp_path))
    assert summary["uncovered_fraction"] == 0
    assert summary["vehicle"]["landed"] is True
    assert summary["vehicle"]["autopilot_version"].startswith("4.")
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


def test_a_two_axis_gimbal_is_panned_by_the_vehicle(tmp_path: Path) -> None:
    # in 8 m/s the simulated airframe shakes at some headings more than any photo bears (docs/mission.md)
    summary = truly_flown(*mission("--sitl", *TWO_AXES, "--wind", "4", output=tmp_path))
    manifest = manifest_in(tmp_path)
    assert summary["turns"] >= len({round(shot["target"]["yaw_deg"], 1) for shot in manifest["shots"]}) - 1
    for attempt in accepted(manifest):
        assert abs(attempt["error_deg"]["pitch"]) <= 0.1
        assert abs(attempt["error_deg"]["yaw"]) <= 2.0


def test_the_vehicle_turns_where_a_gimbal_with_stops_does_not_reach(tmp_path: Path) -> None:
    arguments = ("--sitl", "--yaw", "auto", "--gimbal-pan", "-40", "40", "--elevation", "-20", "20")
    summary = truly_flown(*mission(*arguments, output=tmp_path))
    assert summary["turns"] >= 4
    assert abs(summary["worst"]["yaw_deg"]) <= 0.7


def test_a_camera_on_a_servo_is_proven_by_its_count(tmp_path: Path) -> None:
    summary = truly_flown(*mission("--sitl", "--trigger", "servo", *SMALL, output=tmp_path))
    assert summary["evidence"] == {"counted": summary["shots"]}
    # the payload exposes when the autopilot says that it has triggered; not every attempt comes to that
    assert summary["shots"] <= summary["photos"] <= summary["attempts"]


def test_ctrl_c_ends_everything_and_the_mission_goes_on_later(tmp_path: Path) -> None:
    with whole_under_way(tmp_path) as started:
        started.process.send_signal(signal.SIGINT)
        assert started.process.wait(60) == 130
        started.assert_none_left(within_s=0.0)
    assert list(tmp_path.glob("panoexec-sitl-*")) == []
    (left,) = tmp_path.glob("missions/*")
    assert taken_in(tmp_path) >= 1
    assert_true(left)
    summary = flown("--resume", str(left), timeout_s=LONG_S)
    assert summary["vehicle"]["landed"] is True


def test_nothing_outlives_a_dry_run_that_is_killed(tmp_path: Path) -> None:
    with whole_under_way(tmp_path) as started:
        started.process.send_signal(signal.SIGKILL)
        started.process.wait(10)
        # the renderer may have photos to finish
        started.assert_none_left(within_s=30.0)
    assert list(tmp_path.glob("panoexec-sitl-*")) == []


def test_a_sitl_that_dies_ends_the_dry_run_with_its_name(tmp_path: Path) -> None:
    with whole_under_way(tmp_path) as started:
        os.kill(started.autopilot(), signal.SIGKILL)
        _, error = started.process.communicate(timeout=60)
        assert started.process.returncode == 3
        assert f"{sitl_binary(None)} exited unexpectedly (signal 9)" in error.splitlines()[-1]
        started.assert_none_left(within_s=0.0)


def test_a_vehicle_that_runs_already_is_neither_armed_nor_flown_nor_ended(tmp_path: Path) -> None:
    ground_port, payload_port, rc_port, irlock_port = free_udp_ports(4)
    parameters = ROOT / "config" / "ardupilot-sitl.parm"
    with subprocess.Popen(
        [
            str(sitl_binary(None)),
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
            done = dry_run(*mission(*connect, *SMALL, output=tmp_path), "--json", timeout_s=LONG_S)
            assert done.returncode == 0, done.stderr
            assert "stands on the ground" in done.stderr
            summary = json.loads(done.stdout)
            assert summary["state"] == "complete"
            assert_true(Path(summary["directory"]))
            assert "landed" not in summary["vehicle"]
            assert sitl.poll() is None
        finally:
            sitl.terminate()
            sitl.wait(10)
