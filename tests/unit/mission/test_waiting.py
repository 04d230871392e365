"""Bounded waiting leaves nothing behind and hides nothing."""

from __future__ import annotations

import asyncio

import pytest

from panoexec.errors import DeviceError
from panoexec.mission.waiting import uncancelled, until, within
from tests.unit.fakes.virtual import VirtualClock, run_virtual


async def _value(clock: VirtualClock, after_s: float) -> str:
    await clock.sleep(after_s)
    return "value"


async def _fail(clock: VirtualClock, after_s: float) -> str:
    await clock.sleep(after_s)
    raise DeviceError("refused")


def test_a_result_in_time_and_one_too_late() -> None:
    async def main() -> None:
        clock = VirtualClock()
        assert await within(clock, 1.0, _value(clock, 0.5), "work") == "value"
        began = clock.monotonic()
        with pytest.raises(TimeoutError, match="work: not done after 1 s"):
            await within(clock, 1.0, _value(clock, 5.0), "work")
        assert clock.monotonic() - began == pytest.approx(1.0)

    run_virtual(main())


def test_the_works_own_error_comes_out_as_it_is() -> None:
    async def main() -> None:
        clock = VirtualClock()
        with pytest.raises(DeviceError, match="refused"):
            await within(clock, 1.0, _fail(clock, 0.5), "work")
        with pytest.raises(DeviceError, match="refused"):
            await until(_fail(clock, 0.5), _value(clock, 1.0), "work")

    run_virtual(main())


def test_work_wins_a_tie() -> None:
    async def main() -> None:
        clock = VirtualClock()
        assert await until(clock.sleep(1.0), _value(clock, 1.0), "work") == (True, "value")

    run_virtual(main())


def test_a_cancellation_from_outside_passes_through_and_ends_both() -> None:
    async def main() -> None:
        clock = VirtualClock()
        ended = []

        async def stubborn(name: str) -> None:
            try:
                await clock.sleep(100.0)
            finally:
                ended.append(name)

        task = asyncio.create_task(until(stubborn("stop"), stubborn("work"), "both"))
        await clock.sleep(0.1)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert sorted(ended) == ["stop", "work"]

    run_virtual(main())


def test_what_must_come_to_its_end_does_so_before_a_cancellation_is_obeyed() -> None:
    async def main() -> None:
        clock = VirtualClock()
        ended = []

        async def essential() -> str:
            await clock.sleep(1.0)
            ended.append(clock.monotonic())
            return "done"

        async def caller() -> str:
            return await uncancelled(asyncio.create_task(essential(), name="essential"))

        assert await caller() == "done"
        task = asyncio.create_task(caller())
        for _ in range(3):
            await clock.sleep(0.1)
            task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert len(ended) == 2

    run_virtual(main())


def test_work_that_finishes_while_it_is_cancelled_counts() -> None:
    async def main() -> None:
        clock = VirtualClock()

        async def work() -> str:
            try:
                await clock.sleep(100.0)
            except asyncio.CancelledError:
                return "done all the same"
            return "never"

        assert await until(clock.sleep(1.0), work(), "work") == (True, "done all the same")

    run_virtual(main())
