"""Everything on one computer, in one terminal: started, flown through its broker, and ended by Ctrl-C or a kill."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.system.sitl_runs import children_of
from tests.waiting import eventually

SOON_S = 180.0
STARTED: list[subprocess.Popen[str]] = []
pytestmark = pytest.mark.skipif(
    shutil.which("mosquitto") is None and not Path("/usr/sbin/mosquitto").exists(), reason="mosquitto is not installed"
)


def panoexec(*arguments: str, cwd: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "panoexec", *arguments]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    process = subprocess.Popen(
        command, cwd=cwd, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, encoding="utf-8"
    )
    STARTED.append(process)
    return process


@pytest.fixture(autouse=True)
def _none_is_left() -> Iterator[None]:
    """A test that fails leaves no demo, and with that none of its programs."""
    yield
    for process in STARTED:
        if process.poll() is None:
            process.kill()
            process.wait(30)
    STARTED.clear()


def told(process: subprocess.Popen[str], last: str) -> str:
    """What it says, up to a line."""
    assert process.stderr is not None
    lines = []
    for line in process.stderr:
        lines.append(line)
        if last in line:
            return "".join(lines)
    raise AssertionError(f"{last!r} was not said: {lines}")


def answers(url: str) -> bool:
    with urllib.request.urlopen(url, timeout=30) as answer:
        return bool(answer.status == 200)


def living(processes: set[int]) -> set[int]:
    """Those that run; one that has ended stays as a zombie until somebody has asked for how it ended."""

    def runs(process: int) -> bool:
        try:
            return Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0] != "Z"
        except (FileNotFoundError, ProcessLookupError):
            return False

    return {one for one in processes if runs(one)}


async def test_a_mission_is_flown_and_ctrl_c_ends_everything(tmp_path: Path) -> None:
    demo = panoexec("demo", "--page-port", "0", "--speedup", "8", cwd=tmp_path)
    said = told(demo, "Ctrl-C ends everything")
    (page,) = re.findall(r"http://\S+", said)
    assert answers(page)
    broker = re.findall(r"--host \S+ --port \d+ --vehicle demo", said)[0].split()
    started = panoexec("start", "--preset", "front", *broker, cwd=tmp_path)
    out, err = started.communicate(timeout=120)
    assert started.returncode == 0, err
    assert "images" in out
    children = children_of(demo.pid)
    assert len(children) >= 4
    manifests = tmp_path / "demo" / "flown" / "missions"

    def is_over() -> bool:
        """On a machine that is busy with other things, a shot may be missing."""
        states = [json.loads(file.read_text())["state"] for file in manifests.glob("*/manifest.json")]
        return any(state in {"complete", "incomplete"} for state in states)

    await eventually(is_over, SOON_S * 2)
    status, _ = panoexec("status", *broker, cwd=tmp_path).communicate(timeout=120)
    assert "battery: 95 %" in status, "who reads for an hour can still fly"
    demo.send_signal(signal.SIGINT)
    assert demo.wait(SOON_S) == 130
    assert "ended; the missions are in" in demo.communicate()[1]
    assert not living(children)


async def test_nothing_outlives_one_that_is_killed(tmp_path: Path) -> None:
    demo = panoexec("demo", "--page-port", "0", cwd=tmp_path)
    told(demo, "Ctrl-C ends everything")
    children = children_of(demo.pid)
    demo.kill()
    demo.communicate()

    assert len(children) >= 4
    await eventually(lambda: not living(children), SOON_S)


def test_a_program_that_ends_ends_the_demo_with_its_last_words(tmp_path: Path) -> None:
    demo = panoexec("demo", "--page-port", "0", "--fault", "no-such-fault", cwd=tmp_path)
    _, err = demo.communicate(timeout=120)
    assert demo.returncode == 3
    assert "panoexec: vehicle has ended (panoexec: " in err
    assert "no-such-fault" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--output", "/proc/demo"), "--output /proc/demo: cannot be used"),
        (("--page-port", "70000"), "--page-port 70000: cannot be used"),
        (("--speedup", "0"), "--speedup"),
    ],
)
def test_what_cannot_be_used_is_said_before_anything_starts(
    tmp_path: Path, arguments: tuple[str, ...], words: str
) -> None:
    demo = panoexec("demo", *arguments, cwd=tmp_path)
    out, err = demo.communicate(timeout=60)
    assert (demo.returncode, out, err.count("\n")) == (2, "", 1)
    assert words in err
