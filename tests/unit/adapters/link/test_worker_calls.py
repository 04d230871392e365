import asyncio
import threading

import pytest

from panoexec.adapters.link.worker_calls import WorkerCalls


async def test_results_and_errors_come_back() -> None:
    calls = WorkerCalls("test", threads=2)
    assert await calls.run(lambda: 42) == 42
    with pytest.raises(ZeroDivisionError):
        await calls.run(lambda: 1 // 0)
    assert await calls.run(threading.current_thread) is not threading.current_thread()
    calls.stop()


async def test_a_cancelled_call_runs_to_its_end_and_drain_waits_for_it() -> None:
    calls = WorkerCalls("test", threads=1)
    go, ended = threading.Event(), threading.Event()

    def block() -> None:
        go.wait(60)
        ended.set()

    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.01):
            await calls.run(block)
    assert not await calls.drain(0.01)
    go.set()
    assert await calls.drain(60.0)
    assert ended.is_set()
    calls.stop()


async def test_calls_block_side_by_side() -> None:
    calls = WorkerCalls("test", threads=2)
    meet = threading.Barrier(2)
    async with asyncio.timeout(60):
        places = await asyncio.gather(calls.run(lambda: meet.wait(60)), calls.run(lambda: meet.wait(60)))
    # one after the other, neither would have got through
    assert sorted(places) == [0, 1]
    calls.stop()


def test_a_call_that_ends_after_its_loop_is_harmless() -> None:
    go = threading.Event()
    calls: list[WorkerCalls] = []

    async def abandon() -> None:
        calls.append(WorkerCalls("test", threads=1))
        calls[0].submit(lambda: go.wait(60))
        await asyncio.sleep(0)

    asyncio.run(abandon())
    go.set()
    calls[0].stop()
    for thread in calls[0]._threads:
        thread.join(60)
        assert not thread.is_alive()
        assert thread.daemon


async def test_a_call_that_has_not_begun_is_refused() -> None:
    """A busy machine begins it after MAVSDK was destroyed, which would end the process."""
    calls = WorkerCalls("test", threads=1)
    begun, go_on = threading.Event(), threading.Event()
    made: list[str] = []

    def first() -> None:
        begun.set()
        go_on.wait(30)
        made.append("first")

    running = calls.submit(first)
    waiting = calls.submit(lambda: made.append("second"))
    assert await asyncio.to_thread(begun.wait, 30)
    calls.refuse()
    go_on.set()
    await running
    with pytest.raises(RuntimeError, match="the link is closed"):
        await waiting
    assert made == ["first"]
    calls.stop()
