"""Waits with a timeout on the mission's clock that never leave a task behind."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

from panoexec.clock import Clock

T = TypeVar("T")


async def within(clock: Clock, seconds: float, work: Coroutine[Any, Any, T], name: str) -> T:
    """The result of `work`, cancelled after `seconds` of the clock.

    Raises:
        TimeoutError: it took longer. Whatever `work` raises passes through as it is.
    """
    done, result = await until(clock.sleep(seconds), work, name)
    if not done:
        raise TimeoutError(f"{name}: not done after {seconds:g} s")
    return result  # type: ignore[return-value]


async def until(stop: Coroutine[Any, Any, object], work: Coroutine[Any, Any, T], name: str) -> tuple[bool, T | None]:
    """Run `work` until it is done or `stop` returns; the other one is cancelled and awaited.

    Returns:
        (True, result) when `work` was done, even if `stop` returned in the same moment; else (False, None).

    Raises:
        Exception: what `work` or `stop` raised, not wrapped in a group.
    """
    try:
        async with asyncio.TaskGroup() as group:
            working = group.create_task(work, name=name)
            stopping = group.create_task(stop, name=f"{name}: bound")
            await asyncio.wait({working, stopping}, return_when=asyncio.FIRST_COMPLETED)
            if working.done() and not working.cancelled() and working.exception() is None:
                stopping.cancel()
                return True, working.result()
            if stopping.done() and not working.done():
                working.cancel()
    except BaseExceptionGroup as failures:
        raise first_failure(failures) from None
    if working.done() and not working.cancelled() and working.exception() is None:
        return True, working.result()  # it finished while it was being cancelled
    return False, None


async def uncancelled(task: asyncio.Task[T]) -> T:
    """The result of a task that must finish: a cancellation takes effect only afterwards.

    Only for work with a timeout: releasing the gimbal, the last write of the journal.
    """
    cancelled: asyncio.CancelledError | None = None
    while not task.done():
        try:
            await asyncio.wait({task})
        except asyncio.CancelledError as request:
            cancelled = request
    if cancelled is not None:
        raise cancelled
    return task.result()


def first_failure(group: BaseExceptionGroup[BaseException]) -> BaseException:
    """The first leaf of a group of exceptions."""
    first: BaseException = group
    while isinstance(first, BaseExceptionGroup):
        first = first.exceptions[0]
    return first
