"""MAVSDK is destroyed on purpose, whatever interrupts its making."""

from __future__ import annotations

import asyncio
import threading

import pytest

from panoexec.adapters.link import first_heartbeats
from panoexec.adapters.link.connection_url import parse_connection
from panoexec.adapters.link.mavsdk_session import MavsdkSession
from panoexec.adapters.link.worker_calls import WorkerCalls


class FakeMavsdk:
    """Takes its time to be made."""

    begun = threading.Event()
    go_on = threading.Event()

    def __init__(self, _configuration: object) -> None:
        self.destroyed = False
        MADE.append(self)
        FakeMavsdk.begun.set()
        FakeMavsdk.go_on.wait(30)

    def destroy(self) -> None:
        self.destroyed = True


class FakeConfiguration:
    @classmethod
    def create_manual(cls, *_ids: int, always_send_heartbeats: bool) -> FakeConfiguration:
        assert always_send_heartbeats
        return cls()

    def destroy(self) -> None:
        pass


MADE: list[FakeMavsdk] = []


async def test_what_is_made_after_a_cancelled_opening_is_destroyed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(first_heartbeats, "Mavsdk", FakeMavsdk)
    monkeypatch.setattr(first_heartbeats, "Configuration", FakeConfiguration)
    calls = WorkerCalls("test")
    session = MavsdkSession(parse_connection("udpin://127.0.0.1:1"), calls)
    opening = asyncio.create_task(session.open(1, 191))
    assert await asyncio.to_thread(FakeMavsdk.begun.wait, 30)
    opening.cancel()
    with pytest.raises(asyncio.CancelledError):
        await opening
    closing = asyncio.create_task(session.close())
    FakeMavsdk.go_on.set()
    await closing
    calls.stop()
    assert [mavsdk.destroyed for mavsdk in MADE] == [True]
    await session.close()
    assert len(MADE) == 1
