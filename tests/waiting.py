"""Wait for what nothing announces: poll until a condition holds."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

_ASYNC_STEP_S = 0.01
_STEP_S = 0.02


async def eventually(condition: Callable[[], object], timeout_s: float = 60.0) -> None:
    """Return once a condition holds.

    Args:
        condition: asked for again and again.
        timeout_s: how long.

    Raises:
        TimeoutError: it did not hold in time.
    """
    async with asyncio.timeout(timeout_s):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(_ASYNC_STEP_S)


def wait_until(condition: Callable[[], object], timeout_s: float = 120.0) -> None:
    """The same without an event loop.

    Raises:
        TimeoutError: it did not hold in time.
    """
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() >= end:
            raise TimeoutError(f"the condition did not hold within {timeout_s:g} s")
        time.sleep(_STEP_S)
