"""The fixture that fails tests which leak tasks does so, and the end of a run finds the processes that are left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.repository import ROOT
from tests.waiting import wait_until

pytest_plugins = ["pytester"]
LEAKY = """
import asyncio

async def test_leaks():
    asyncio.get_running_loop().keep = asyncio.create_task(asyncio.sleep(60), name="forgotten")

async def test_keeps_order():
    await asyncio.create_task(asyncio.sleep(0))

def test_is_not_asynchronous():
    pass
"""
STARTS = """
import pathlib, subprocess, sys, time, pytest

PROGRAM = "import sys, time; print('runs', flush=True); time.sleep(600)"

def started(told="pid"):
    # in a session of its own, as a daemon may be
    process = subprocess.Popen([sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, start_new_session=True)
    process.stdout.readline()
    pathlib.Path(told).write_text(str(process.pid))
    return process

@pytest.mark.filterwarnings("ignore")
def test_starts_one():
    globals()["kept"] = started("left")

def test_ends_what_it_starts():
    with started() as process:
        process.kill()

def test_waits():
    with started():
        time.sleep(600)
"""
INI = "[pytest]\nasyncio_mode = auto\nasyncio_default_fixture_loop_scope = function\n"


@pytest.fixture
def inner(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> pytest.Pytester:
    """A run of its own, with this conftest."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    pytester.makeconftest((ROOT / "tests" / "conftest.py").read_text(encoding="utf-8"))
    pytester.makeini(INI)
    return pytester


def runs(process: int) -> bool:
    return bool(_read(process, "environ"))  # a zombie has none


def _read(process: int, name: str) -> bytes:
    try:
        return Path(f"/proc/{process}/{name}").read_bytes()
    except OSError:
        return b""


def test_a_leaked_task_fails_its_test(inner: pytest.Pytester) -> None:
    inner.makepyfile(LEAKY)
    result = inner.runpytest_subprocess("-p", "no:cacheprovider")
    result.assert_outcomes(passed=3, errors=1)
    result.stdout.fnmatch_lines(["*the test left 1 tasks running: forgotten*"])


def test_a_process_that_is_left_fails_the_run_and_is_ended(
    inner: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTEST_LEFTOVERS_S", "0.5")
    inner.makepyfile(STARTS)
    result = inner.runpytest_subprocess("-p", "no:cacheprovider", "-n", "1", "-k", "starts_one or ends_what")
    assert result.ret == pytest.ExitCode.TESTS_FAILED
    result.assert_outcomes(passed=2)
    process = int((inner.path / "left").read_text())
    (line,) = [line for line in result.outlines if ", started by " in line]
    assert line.startswith(f"{process}, started by test_a_process_that_is_left")
    assert "::test_starts_one (call): " in line
    assert not runs(process)


def test_a_run_that_is_killed_leaves_no_process(inner: pytest.Pytester) -> None:
    inner.makepyfile(STARTS)
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-k", "waits"]
    with subprocess.Popen(command, cwd=inner.path, stdout=subprocess.DEVNULL) as run:
        told = inner.path / "pid"
        wait_until(lambda: told.exists() and told.read_text(), 60)
        process = int(told.read_text())
        assert runs(process)
        os.kill(run.pid, signal.SIGKILL)
    wait_until(lambda: not runs(process))
