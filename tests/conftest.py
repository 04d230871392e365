"""What every test gets: no asyncio task may outlive it, and a busy machine fails no property."""

from __future__ import annotations

import asyncio
import inspect
import logging
from collections.abc import AsyncIterator, Iterator

import pytest
import structlog
from hypothesis import HealthCheck, settings

# by default an example that takes more than 0.2 s fails its test, and so do inputs that are slow to draw; both
# depend on what else the machine does. The examples are the same in every run, so that a change is judged by what it
# changes; `--hypothesis-profile explore` (the campaigns use it) draws others
settings.register_profile("explore", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("same", settings.get_profile("explore"), derandomize=True)
settings.load_profile("same")


@pytest.fixture
def restored_logs() -> Iterator[None]:
    """Puts back how the tests log after one that has set up logging for its process."""
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
