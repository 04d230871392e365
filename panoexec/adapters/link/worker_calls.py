"""Blocking calls in daemon threads, which never block the shutdown.

MAVSDK's commands block until they are answered or time out (measured: 2.0 s on a dead link), continue after their
`await` was cancelled, and block for ever if the `Mavsdk` instance is destroyed meanwhile (measured). The event loop's
own executor would then hang at shutdown, because it joins its threads. So the threads are daemons, and `drain` waits
for running calls before anything is destroyed.
"""

from __future__ import annotations

import asyncio
import contextlib
import queue
import threading
from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")

_Job = tuple[int, Callable[[], Any], asyncio.AbstractEventLoop, "asyncio.Future[Any]"]


class WorkerCalls:
    """A pool of daemon threads that runs blocking calls for one event loop."""

    def __init__(self, name: str, threads: int = 4) -> None:
        """Start the threads: `name` is their prefix, `threads` the number of calls that can block at once."""
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._busy = 0
        self._refused = 0
        self._idle = asyncio.Event()
        self._idle.set()
        self._threads = [
            threading.Thread(target=self._work, name=f"{name}-{number}", daemon=True) for number in range(threads)
        ]
        for thread in self._threads:
            thread.start()

    async def run(self, call: Callable[[], T]) -> T:
        """Run `call` in a thread and return its result; a cancelled `await` does not interrupt the call."""
        return await self.submit(call)

    def submit(self, call: Callable[[], T]) -> asyncio.Future[T]:
        """Run `call` in a thread and return its future; call this on the event loop."""
        loop = asyncio.get_running_loop()
        future: asyncio.Future[T] = loop.create_future()
        self._busy += 1
        self._idle.clear()
        self._jobs.put((self._refused, call, loop, future))
        return future

    async def drain(self, timeout_s: float) -> bool:
        """Wait until no call runs, at most `timeout_s` (real seconds); False at the timeout."""
        try:
            async with asyncio.timeout(timeout_s):
                await self._idle.wait()
        except TimeoutError:
            return False
        return True

    def refuse(self) -> None:
        """Start none of the calls that wait for a thread: what they use is destroyed. They fail with RuntimeError."""
        self._refused += 1

    def stop(self) -> None:
        """Let the threads end after their queued calls; does not wait."""
        for _ in self._threads:
            self._jobs.put(None)

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            asked, call, loop, future = job
            result, error = None, None
            try:
                result = call() if asked == self._refused else _refused()
            except Exception as caught:  # noqa: BLE001 - passed to the caller
                error = caught
            # the loop was closed meanwhile: no task waits
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(self._done, future, result, error)
            del job, call, future, result, error

    def _done(self, future: asyncio.Future[Any], result: object, error: Exception | None) -> None:
        self._busy -= 1
        if not self._busy:
            self._idle.set()
        if future.done():
            return
        if error is not None:
            future.set_exception(error)
        else:
            future.set_result(result)


def _refused() -> Any:
    raise RuntimeError("the link is closed")
