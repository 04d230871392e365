"""Scripted peers, and a link to one, for tests over real sockets."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.clock import SystemClock
from tests.wire.scripted_peer import GimbalPeer, ScriptedPeer, listening


@pytest.fixture
async def autopilot() -> AsyncIterator[ScriptedPeer]:
    """A scripted autopilot without payload."""
    async with listening(ScriptedPeer()) as one:
        yield one


@pytest.fixture
async def link(autopilot: ScriptedPeer) -> AsyncIterator[MavsdkLink]:
    """A link to `autopilot`, found."""
    async with MavsdkLink(autopilot.url, clock=SystemClock()) as one:
        await one.wait_autopilot(60)
        yield one


@pytest.fixture
async def gimbal_autopilot() -> AsyncIterator[GimbalPeer]:
    """A scripted autopilot that drives a gimbal."""
    async with listening(GimbalPeer()) as one:
        yield one


@pytest.fixture
async def gimbal_link(gimbal_autopilot: GimbalPeer) -> AsyncIterator[MavsdkLink]:
    """A link to `gimbal_autopilot`, found."""
    async with MavsdkLink(gimbal_autopilot.url, clock=SystemClock()) as one:
        await one.wait_autopilot(60)
        yield one
