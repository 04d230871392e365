"""Virtual time: an event loop whose clock jumps to the next timer when every task waits."""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Callable, Coroutine
from concurrent.futures import Executor
from typing import Any, TypeVar

T = TypeVar("T")


class DeadlockError(AssertionError):
    """Every task waits, and no timer will ever wake one."""


class _Selector(selectors.DefaultSelector):
    loop: VirtualLoop

    def select(self, timeout: float | None = None) -> Any:
        ready = super().select(0)
        if ready or timeout == 0:
            return ready
        if self.loop.threads_busy:
            return super().select(None)  # a thread works: that takes no virtual time
        if timeout is None:
            raise DeadlockError("all tasks wait for ever")
        self.loop.virtual_s += timeout
        return []


class VirtualLoop(asyncio.SelectorEventLoop):
    """Runs as fast as it can; `time` is virtual. Work in threads takes no virtual time at all."""

    def __init__(self) -> None:
        self.virtual_s = 1000.0
        self.threads_busy = 0
        selector = _Selector()
        selector.loop = self
        super().__init__(selector)

    def time(self) -> float:
        return self.virtual_s

    def run_in_executor(  # type: ignore[override]
        self, executor: Executor | None, func: Callable[..., T], *args: Any
    ) -> asyncio.Future[T]:
        future = super().run_in_executor(executor, func, *args)
        self.threads_busy += 1

        def done(_: object) -> None:
            self.threads_busy -= 1

        future.add_done_callback(done)
        return future

    async def shutdown_default_executor(self, *args: Any) -> None:
        self.threads_busy += 1  # threads are joined: real time
        await super().shutdown_default_executor(*args)
        self.threads_busy -= 1


class VirtualClock:
    """The clock of the running virtual loop."""

    def monotonic(self) -> float:
        return asyncio.get_running_loop().time()

    def time(self) -> float:
        return 1_700_000_000.0 + self.monotonic()

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(max(0.0, seconds))


def run_virtual(main: Coroutine[Any, Any, T], *, limit_s: float = 100_000.0) -> T:
    """Run `main` in virtual time; fails if it leaves tasks behind or takes longer than `limit_s`."""

    async def guarded() -> T:
        async with asyncio.timeout(limit_s):
            result = await main
        left = asyncio.all_tasks() - {asyncio.current_task()}
        assert not left, f"tasks left running: {sorted(task.get_name() for task in left if task)}"
        return result

    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(guarded())
