"""A link that is closed: at once, with calls that run, and without anything left."""

from __future__ import annotations

import asyncio
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import structlog

from panoexec.adapters.link import mavsdk_session
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.clock import SystemClock
from panoexec.errors import DeviceError, LinkError
from tests.waiting import eventually
from tests.wire.scripted_peer import IN_PROGRESS, ScriptedPeer, listening

CLOCK = SystemClock()


async def test_closes_in_no_time_when_idle(autopilot: ScriptedPeer, monkeypatch: pytest.MonkeyPatch) -> None:
    """By what it waits for: no call is running, and MAVSDK is gone before the time for that is over."""
    monkeypatch.setattr(mavsdk_session, "_DRAIN_S", 0.0)
    monkeypatch.setattr(mavsdk_session, "_DESTROY_S", 3600.0)
    with structlog.testing.capture_logs() as logs:
        async with asyncio.timeout(120), MavsdkLink(autopilot.url, clock=CLOCK) as link:
            await link.wait_autopilot(60)
            await eventually(lambda: not link._calls._busy)
    assert not gave_up(logs)
    async with MavsdkLink(autopilot.url, clock=CLOCK) as link:  # and the port is free again
        await link.wait_autopilot(60)


async def test_what_the_block_raises_passes_as_it_is(autopilot: ScriptedPeer) -> None:
    error = DeviceError("of the block")
    with pytest.raises(DeviceError) as caught:
        async with MavsdkLink(autopilot.url, clock=CLOCK):
            raise error
    assert caught.value is error


async def test_a_cancelled_block_is_cancelled_and_the_link_closed(autopilot: ScriptedPeer) -> None:
    entered = asyncio.Event()

    async def block() -> None:
        async with MavsdkLink(autopilot.url, clock=CLOCK):
            entered.set()
            await asyncio.Event().wait()

    task = asyncio.create_task(block())
    await entered.wait()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    async with MavsdkLink(autopilot.url, clock=CLOCK) as link:
        await link.wait_autopilot(60)


def gave_up(logs: Sequence[Any]) -> bool:
    """Whether a link was closed while a call of MAVSDK was still running."""
    return any(entry["event"] == "MAVSDK call timed out" for entry in logs)


async def test_closing_waits_for_an_unanswered_command_but_not_for_ever(
    autopilot: ScriptedPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert mavsdk_session._DRAIN_S + mavsdk_session._DESTROY_S == 6.0
    monkeypatch.setattr(mavsdk_session, "_DRAIN_S", 60.0)  # MAVSDK gives the command up after two
    autopilot.answers[31_002] = lambda _: None
    with structlog.testing.capture_logs() as logs:
        async with asyncio.timeout(120), MavsdkLink(autopilot.url, clock=CLOCK) as link:
            await link.wait_autopilot(60)
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.2):
                    await link.requests.command(31_002)
    assert not gave_up(logs)
    assert not link._calls._busy
    with pytest.raises(LinkError):
        await link.requests.command(511)


async def test_closing_leaves_a_command_that_makes_progress_for_ever(
    autopilot: ScriptedPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mavsdk_session, "_DRAIN_S", 0.5)
    autopilot.answers[31_003] = lambda _: IN_PROGRESS
    stop = asyncio.Event()

    async def progress() -> None:
        while not stop.is_set():
            for command in autopilot.sent(31_003)[:1]:
                autopilot.acknowledge(command, IN_PROGRESS)
            await asyncio.sleep(0.2)

    with structlog.testing.capture_logs() as logs:
        async with asyncio.timeout(120), asyncio.TaskGroup() as group:
            group.create_task(progress())
            async with MavsdkLink(autopilot.url, clock=CLOCK) as link:
                await link.wait_autopilot(60)
                with pytest.raises(TimeoutError):
                    async with asyncio.timeout(0.2):
                        await link.requests.command(31_003)
            stop.set()
    assert gave_up(logs)
    async with MavsdkLink(autopilot.url, clock=CLOCK) as link:
        await link.wait_autopilot(60)


async def test_nothing_is_left_in_the_temporary_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """MAVSDK makes a folder for each system that it meets, and leaves it."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    old, full = (tmp_path / f"mavsdk-component-metadata-{name}" for name in ("old", "full"))
    old.mkdir()
    os.utime(old, (1.0, 1.0))
    async with listening(ScriptedPeer()) as peer, MavsdkLink(peer.url, clock=CLOCK) as link:
        await link.wait_autopilot(60)
        full.mkdir()
        (full / "file").touch()
        assert len(_inside(tmp_path)) > 2
    assert _inside(tmp_path) == {old, full}


def _inside(folder: Path) -> set[Path]:
    return set(folder.iterdir())
