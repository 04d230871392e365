"""The dry-run on PX4's own software (SIH). Opt in: PX4_SITL=/path/to/build/px4_sitl_default/bin/px4 pytest …

What is asserted holds at any speed of the machine: PX4's SIH cannot be slowed down while it runs, so a busy machine may
reject a photo here and there and take it again.
"""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from panoexec.dryrun.autopilot import sitl_binary
from panoexec.dryrun.px4 import BINARY_VARIABLE
from panoexec.sim.config import AirframeConfig
from tests.system import sitl_runs
from tests.system.dry_runs import accepted, flown
from tests.system.sitl_runs import (
    LONG_S,
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

pytestmark = pytest.mark.skipif(
    not os.environ.get(BINARY_VARIABLE), reason=f"set {BINARY_VARIABLE} to PX4's SITL binary to run it"
)


def binary() -> Path:
    return sitl_binary(os.environ[BINARY_VARIABLE])


def mission(*arguments: str, output: Path) -> list[str]:
    return sitl_runs.mission("--sitl", str(binary()), *arguments, speedup=SPEEDUP, output=output)


@contextlib.contextmanager
def whole_under_way(output: Path) -> Iterator[Started]:
    with in_the_middle(mission(*WHOLE, output=output), binary=binary(), temporary=output) as started:
        yield started


def locks_of(started: Started) -> list[Path]:
    """What PX4 keeps outside its folder, by the instance that its command line names."""
    words = started.living()[started.autopilot()].split()
    instance = words[words.index("-i") + 1]
    found = [Path(f"/tmp/px4_lock-{instance}"), Path(f"/tmp/px4-sock-{instance}")]
    assert any(path.exists() for path in found)
    return found


def test_a_whole_panorama_in_wind_and_back_on_the_ground(tmp_path: Path) -> None:
    summary = truly_flown(*mission(*WHOLE, output=tmp_path))
    assert summary["uncovered_fraction"] == 0
    assert summary["vehicle"]["landed"] is True
    assert set(summary["evidence"]) <= {"capture_message", "file_seen"}
    assert sum(summary["evidence"].values()) == summary["shots"]
    manifest = manifest_in(tmp_path)
    for attempt in accepted(manifest):
        assert abs(attempt["error_deg"]["pitch"]) <= 0.1
        assert abs(attempt["error_deg"]["roll"]) <= 0.1
        assert abs(attempt["error_deg"]["yaw"]) <= 0.7
    home = AirframeConfig()
    position = manifest["position"]
    assert position["latitude_deg"] == pytest.approx(home.latitude_deg, abs=1e-4)
    assert position["longitude_deg"] == pytest.approx(home.longitude_deg, abs=1e-4)
    assert position["altitude_m"] == pytest.approx(home.home_altitude_m + 30.0, abs=3.0)


def test_a_two_axis_gimbal_is_panned_by_the_vehicle(tmp_path: Path) -> None:
    summary = truly_flown(*mission(*TWO_AXES, output=tmp_path))
    shots = manifest_in(tmp_path)["shots"]
    assert summary["turns"] >= len({round(shot["target"]["yaw_deg"], 1) for shot in shots}) - 1
    assert abs(summary["worst"]["yaw_deg"]) <= 2.0


def test_ctrl_c_ends_everything_and_the_mission_goes_on_later(tmp_path: Path) -> None:
    with whole_under_way(tmp_path) as started:
        locks = locks_of(started)
        started.process.send_signal(signal.SIGINT)
        assert started.process.wait(60) == 130
        started.assert_none_left(within_s=0.0)
    assert list(tmp_path.glob("panoexec-sitl-*")) == []
    assert not any(path.exists() for path in locks)
    (left,) = tmp_path.glob("missions/*")
    assert taken_in(tmp_path) >= 1
    assert_true(left)
    summary = flown("--resume", str(left), timeout_s=LONG_S)
    assert summary["vehicle"]["landed"] is True


def test_nothing_outlives_a_dry_run_that_is_killed(tmp_path: Path) -> None:
    with whole_under_way(tmp_path) as started:
        left = locks_of(started)
        left += tmp_path.glob("panoexec-sitl-*")
        assert len(left) == 3
        started.process.send_signal(signal.SIGKILL)
        started.process.wait(10)
        # the renderer may have photos to finish
        started.assert_none_left(within_s=30.0)
    assert [path for path in left if path.exists()] == []
