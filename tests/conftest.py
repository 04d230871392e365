"""What every test gets: no asyncio task may outlive it, no process the run, and a busy machine fails no property."""

from __future__ import annotations

import asyncio
import inspect
import logging
import os
import signal
import sys
from collections.abc import AsyncIterator, Generator, Iterator

import pytest
import structlog
from hypothesis import HealthCheck, settings

from tests.leftovers import Guard

# hundreds of interpreters are started: without bytecode of what they import, each would compile it, for longer than
# everything else that the suite computes
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# a shell starts what runs in its background with SIGINT ignored, and so would be every process that a test stops by it
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# by default an example that takes more than 0.2 s fails its test, and so do inputs that are slow to draw; both
# depend on what else the machine does. The examples are the same in every run, so that a change is judged by what it
# changes; `--hypothesis-profile explore` (the campaigns use it) draws others
settings.register_profile("explore", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("same", settings.get_profile("explore"), derandomize=True)
settings.load_profile("same")

_GUARD = pytest.StashKey[Guard]()
_LEFT = pytest.StashKey[dict[int, str]]()


def pytest_configure(config: pytest.Config) -> None:
    """Mark the processes that tests will start."""
    if not hasattr(config, "workerinput"):  # once, not in each worker
        config.stash[_GUARD] = Guard()


@pytest.hookimpl(wrapper=True, trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> Generator[None]:
    """Fail a run that leaves processes, and end them."""
    yield
    if guard := session.config.stash.get(_GUARD, None):
        session.config.stash[_LEFT] = left = guard.close()
        if left and session.exitstatus in {pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED}:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Name the tests that left processes."""
    if left := config.stash.get(_LEFT, None):
        terminalreporter.section("processes that tests left running", red=True)
        for process, what in left.items():
            terminalreporter.write_line(f"{process}, started by {what}")


@pytest.fixture(autouse=True)
def restored_logs() -> Iterator[None]:
    """Puts back how the tests log after one that has set up logging for its process.

    What it has set up writes to the standard error of that test, which is closed when the test is over; threads that
    outlive it would fail to log.
    """
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield
    root.handlers[:] = handlers
    root.setLevel(level)
    structlog.reset_defaults()
    structlog.contextvars.clear_contextvars()


@pytest.fixture
async def _no_task_left() -> AsyncIterator[None]:
    before = asyncio.all_tasks()
    yield
    # the teardown runs in a task of its own
    left = {task for task in asyncio.all_tasks() - before if task is not asyncio.current_task()}
    for task in left:
        task.cancel()
    if left:
        await asyncio.wait(left)
        names = ", ".join(sorted(task.get_name() for task in left))
        pytest.fail(f"the test left {len(left)} tasks running: {names}")


@pytest.fixture(autouse=True)
def no_leaked_tasks(request: pytest.FixtureRequest) -> None:
    """Fail an asynchronous test that leaves tasks running once its own fixtures are gone."""
    if inspect.iscoroutinefunction(getattr(request.node, "obj", None)):
        request.getfixturevalue("_no_task_left")
