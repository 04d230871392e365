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
from typing import Any

import pytest

from panoexec.dryrun.arducopter import BINARY_VARIABLE
from panoexec.dryrun.autopilot import sitl_binary
from panoexec.dryrun.firmware import free_udp_ports
from panoexec.sim.config import AirframeConfig
from tests.repository import ROOT
from tests.system.dry_runs import accepted, dry_run, flown, under_way
from tests.waiting import wait_until

SPEEDUP = "5"
MISSION = ("--method", "paper", "--wind", "8", "--speedup", SPEEDUP, "--image-width", "200")
WHOLE = ("--camera", "dji-x5s-15mm", "--overlap", "0.15", "--elevation", "-90", "30")
SMALL = ("--elevation", "-20", "20", "--azimuth", "-40", "40")
LONG_S = 400.0

pytestmark = pytest.mark.skipif(
    not os.environ.get(BINARY_VARIABLE), reason=f"set {BINARY_VARIABLE} to an ArduCopter SITL binary to run it"
)


def mission(*arguments: str, output: Path) -> list[str]:
    return [*MISSION, *arguments, "--output", str(output)]


def children_of(pid: int) -> set[int]:
    """All processes below one."""
    parents: dict[int, int] = {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            with contextlib.suppress(OSError):
                stat = (folder / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
                parents[int(folder.name)] = int(stat[1])
    found: set[int] = set()
    grown = {pid}
    while grown:
        grown = {child for child, parent in parents.items() if parent in grown} - found
        found |= grown
    return found


def living(pids: set[int]) -> dict[int, str]:
    """Those that still run, with their command lines; ids may be used again, so an empty one is nobody's."""
    found = {}
    for pid in pids:
        with contextlib.suppress(OSError):
            folder = Path(f"/proc/{pid}")
            if (folder / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z":
                found[pid] = (folder / "cmdline").read_text(encoding="utf-8").replace("\0", " ")
    return {pid: line for pid, line in found.items() if "arducopter" in line or "panoexec" in line}


def assert_none_left(pids: set[int], *, within_s: float) -> None:
    with contextlib.suppress(TimeoutError):
        wait_until(lambda: not living(pids), within_s)
    assert living(pids) == {}


@contextlib.contextmanager
def in_the_middle(tmp_path: Path, *arguments: str) -> Iterator[tuple[subprocess.Popen[str], set[int]]]:
    """A mission on SITL that has taken its second photo, and everything that it started."""
    given = mission(*WHOLE, *arguments, output=tmp_path)
    with under_way(*given, "--json", said="shot 1, attempt", temporary=tmp_path) as process:
        children = children_of(process.pid)
        assert any("arducopter" in line for line in living(children).values())
        yield process, children


def manifest_in(folder: Path) -> dict[str, Any]:
    (path,) = folder.glob("missions/*/manifest.json")
    return dict(json.loads(path.read_text(encoding="utf-8")))


def test_a_whole_panorama_in_wind_and_back_on_the_ground(tmp_path: Path) -> None:
    summary = flown(*mission("--sitl", *WHOLE, output=tmp_path), timeout_s=LONG_S)
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
    calm = ("--wind", "4")
    arguments = ("--sitl", "--yaw", "vehicle", *calm, "--elevation", "-60", "10", "--azimuth", "-90", "90")
    summary = flown(*mission(*arguments, output=tmp_path), timeout_s=LONG_S)
    manifest = manifest_in(tmp_path)
    assert summary["turns"] >= len({round(shot["target"]["yaw_deg"], 1) for shot in manifest["shots"]}) - 1
    for attempt in accepted(manifest):
        assert abs(attempt["error_deg"]["pitch"]) <= 0.1
        assert abs(attempt["error_deg"]["yaw"]) <= 2.0


def test_the_vehicle_turns_where_a_gimbal_with_stops_does_not_reach(tmp_path: Path) -> None:
    arguments = ("--sitl", "--yaw", "auto", "--gimbal-pan", "-40", "40", "--elevation", "-20", "20")
    summary = flown(*mission(*arguments, output=tmp_path), timeout_s=LONG_S)
    assert summary["turns"] >= 4
    assert abs(summary["worst"]["yaw_deg"]) <= 0.7


def test_a_camera_on_a_servo_is_proven_by_its_count(tmp_path: Path) -> None:
    summary = flown(*mission("--sitl", "--trigger", "servo", *SMALL, output=tmp_path), timeout_s=LONG_S)
    assert summary["evidence"] == {"counted": summary["shots"]}
    # the payload exposes when the autopilot says that it has triggered; not every attempt comes to that
    assert summary["shots"] <= summary["photos"] <= summary["attempts"]


def test_ctrl_c_ends_everything_and_the_mission_goes_on_later(tmp_path: Path) -> None:
    with in_the_middle(tmp_path, "--sitl") as (process, children):
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 130
        assert_none_left(children, within_s=0.0)
    assert list(tmp_path.glob("panoexec-sitl-*")) == []
    (left,) = tmp_path.glob("missions/*")
    taken = sum(shot["status"] == "accepted" for shot in manifest_in(tmp_path)["shots"])
    assert taken >= 1
    summary = flown("--resume", str(left), timeout_s=LONG_S)
    assert summary["vehicle"]["landed"] is True


def test_nothing_outlives_a_dry_run_that_is_killed(tmp_path: Path) -> None:
    with in_the_middle(tmp_path, "--sitl") as (process, children):
        process.send_signal(signal.SIGKILL)
        process.wait(10)
        # the renderer may have photos to finish
        assert_none_left(children, within_s=30.0)


def test_a_sitl_that_dies_ends_the_dry_run_with_its_name(tmp_path: Path) -> None:
    with in_the_middle(tmp_path, "--sitl") as (process, children):
        (sitl,) = [pid for pid, line in living(children).items() if line.startswith(str(sitl_binary(None)))]
        os.kill(sitl, signal.SIGKILL)
        _, error = process.communicate(timeout=60)
        assert process.returncode == 3
        assert f"{sitl_binary(None)} exited unexpectedly (signal 9)" in error.splitlines()[-1]
        assert_none_left(children, within_s=0.0)


def test_a_vehicle_that_runs_already_is_neither_armed_nor_flown_nor_ended(tmp_path: Path) -> None:
    ground_port, payload_port, rc_port, irlock_port = free_udp_ports(4)
    parameters = ROOT / "config" / "ardupilot-sitl.parm"
    with subprocess.Popen(
        [
            str(sitl_binary(None)),
            *("--model", "+", "--wipe", "--speedup", SPEEDUP, "--defaults", str(parameters)),
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
            assert "landed" not in summary["vehicle"]
            assert sitl.poll() is None
        finally:
            sitl.terminate()
            sitl.wait(10)
