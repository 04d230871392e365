"""The dry-run as users type it: a process, real UDP, real files."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
from PIL import Image

from panoexec.angles import rotation_from_quaternion
from panoexec.cli.app import run
from panoexec.planning.geometry.pose_error import pose_error
from tests.system.dry_runs import accepted, dry_run, flown, manifest_of, under_way

# the verb sets up logging for its process
pytestmark = pytest.mark.usefixtures("restored_logs")

SMALL = ("--elevation", "-30", "20", "--azimuth", "-50", "50", "--image-width", "160")
TOLERANCE = ("--tolerance-pitch", "0.15", "--tolerance-roll", "0.15", "--tolerance-yaw", "0.7")
LIMITS = {"pitch": 0.15, "roll": 0.15, "yaw": 0.7}


def assert_accepted_within_tolerance(manifest: dict[str, Any]) -> None:
    for attempt in accepted(manifest):
        assert all(abs(attempt["error_deg"][axis]) <= limit for axis, limit in LIMITS.items())
        # judged anew from the quaternion, not from what the manifest says of it
        measured = rotation_from_quaternion(np.array(attempt["measured"]["quaternion"]))
        error = pose_error(attempt["target"]["pitch_deg"], attempt["target"]["yaw_deg"], measured)
        assert abs(float(error.pitch_deg)) <= LIMITS["pitch"]
        assert abs(float(error.roll_deg)) <= LIMITS["roll"]
        assert abs(float(error.yaw_deg)) <= LIMITS["yaw"]


@pytest.fixture
def busy_computer() -> Iterator[None]:
    """Two processes beside the test that never rest, if PANOEXEC_BUSY is set: the other tests are enough otherwise."""
    if not os.environ.get("PANOEXEC_BUSY"):
        yield
        return
    command = [sys.executable, "-S", "-c", "while True: pass"]
    with subprocess.Popen(command) as first, subprocess.Popen(command) as second:
        yield
        first.kill()
        second.kill()


@pytest.mark.usefixtures("busy_computer")
def test_a_mission_ends_complete_with_photos_and_manifest(tmp_path: Path) -> None:
    """As fast as it goes on a busy computer: nothing is late by the clock that counts, no photo is lost to that."""
    summary = flown(*SMALL, *TOLERANCE, "--speedup", "20", "--output", str(tmp_path))
    assert summary["rejected"] == {}
    assert summary["attempts"] == summary["accepted"] == summary["photos"] == summary["shots"]
    assert 0.9 < summary["limit_ratio"] <= 1.15
    manifest = manifest_of(summary)
    assert manifest["state"] == "complete"
    assert manifest["certificate"]["uncovered_fraction"] == 0
    assert_accepted_within_tolerance(manifest)
    folder = Path(summary["directory"])
    assert folder.parent == tmp_path / "missions"
    for shot in manifest["shots"]:
        with PIL.Image.open(folder / shot["file"]) as picture:
            picture.load()
            assert picture.format == "JPEG"
            assert picture.width == 160
    assert summary["report"] == str(folder / "report.html")
    for name in ("plan.json", "panorama.pto", "papywizard.xml", "shots.csv", "report.html"):
        assert (folder / name).stat().st_size > 0, name


def test_drift_is_rejected_with_a_reason_and_retaken_on_px4_too(tmp_path: Path) -> None:
    vehicle = ("--autopilot", "px4", "--fault", "drift=#1,#3", "--speedup", "20")
    summary = flown(*SMALL, *TOLERANCE, *vehicle, "--output", str(tmp_path))
    assert summary["vehicle"]["autopilot"] == "px4"
    manifest = manifest_of(summary)
    attempts = [attempt for shot in manifest["shots"] for attempt in shot["attempts"]]
    rejected = [attempt for attempt in attempts if attempt["verdict"] == "rejected"]
    assert [attempt for attempt in rejected if attempt["code"] == "pointing" and "off by" in attempt["reason"]]
    assert all(shot["status"] == "accepted" for shot in manifest["shots"])
    assert_accepted_within_tolerance(manifest)


@pytest.mark.parametrize(
    ("arguments", "code", "part"),
    [
        (("--camera", "no-such-camera"), 2, "no-such-camera"),
        (("--overlap", "1.2"), 2, "1.2"),
        (("--overlap", "15"), 2, "0.15"),
        (("--elevation", "30", "-90"), 2, "reversed"),
        (("--speedup", "0"), 2, "--speedup 0: expected more than 0"),
        (("--speedup", "-3"), 2, "--speedup -3: expected more than 0"),
        (("--speedup", "nan"), 2, "--speedup nan: expected more than 0"),
        (("--fault", "gremlins"), 2, "unknown fault 'gremlins'; known are attitude-frozen, attitude-late"),
        (("--sitl", "/no/such/binary"), 2, "no such file"),
        (("--sitl", __file__), 2, "a script"),
        (("--scene", __file__), 2, "is no image"),
        (("--resume", "/no/such/mission"), 2, "/no/such/mission"),
        (("--attach", "tcp:127.0.0.1:1"), 2, "--sitl-connect"),
        (("--output", f"{__file__}/below"), 2, "is not a folder"),
        (("--output", "/proc/panoexec"), 2, "/proc/panoexec"),
        (("--tolerance-yaw", "0"), 2, "must be more than 0"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], code: int, part: str
) -> None:
    given = arguments if "--output" in arguments else (*arguments, "--output", str(tmp_path))
    # in this process: starting one costs more than all that is tested here
    assert run(["dry-run", *given]) == code
    out, err = capsys.readouterr()
    assert part in err
    assert len(err.strip().splitlines()) == 1
    assert out == ""
    assert list(tmp_path.iterdir()) == []


def test_a_mission_that_never_began_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    binary = tmp_path / "arducopter"
    binary.write_text(f"#!{sys.executable} -S\nprint('panic: no frame'); raise SystemExit(7)\n", encoding="utf-8")
    binary.chmod(0o755)
    output = tmp_path / "out"
    assert run(["dry-run", *SMALL, "--sitl", str(binary), "--output", str(output)]) == 3
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines()[-1] == (
        f"panoexec: the SITL {binary} exited unexpectedly (exit code 7); last output: panic: no frame"
    )
    assert list(output.iterdir()) == []


def test_a_vehicle_on_a_port_in_use_is_one_line_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("0.0.0.0", 0))
        url = f"udpin://0.0.0.0:{taken.getsockname()[1]}"
        assert run(["dry-run", *SMALL, "--sitl-connect", url, "--output", str(tmp_path)]) == 3
    said = capsys.readouterr().err.splitlines()
    assert said[-1].startswith(f"panoexec: cannot open {url}: UDP port")
    assert "in use" in said[-1]
    assert list(tmp_path.iterdir()) == []


def test_a_truncated_plan_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    path.write_text('{"shots": [{"pitch_deg": 0, "ya', encoding="utf-8")
    done = dry_run("--plan", str(path))
    assert done.returncode == 2
    assert "not valid JSON (truncated?)" in done.stderr


def test_an_interrupted_mission_ends_130_leaves_no_process_and_is_resumed(tmp_path: Path) -> None:
    given = [*SMALL, *TOLERANCE, "--output", str(tmp_path), "--speedup", "2"]
    with under_way(*given, said="accepted") as process:
        process.send_signal(signal.SIGINT)
        process.communicate()
        assert process.wait(30) == 130
        group = process.pid
    # nobody of the session that it led is left
    with pytest.raises(ProcessLookupError):
        os.killpg(group, 0)
    (mission,) = (tmp_path / "missions").iterdir()
    assert "paused" in (mission / "report.html").read_text(encoding="utf-8")
    # photos that were still being rendered are whole or not there
    images = mission / "images"
    assert {path.suffix for path in images.iterdir()} <= {".jpg", ".jsonl", ".xmp"}
    for path in images.glob("*.jpg"):
        with Image.open(path) as image:
            image.load()
    manifest = manifest_of(flown("--resume", str(mission)))
    assert manifest["state"] == "complete"
    assert_accepted_within_tolerance(manifest)
    again = dry_run("--resume", str(mission))
    assert again.returncode == 2
    assert "complete" in again.stderr
