"""Photos by MAVLink FTP: MAVSDK's client against the simulated camera, over UDP."""

from __future__ import annotations

import random
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from panoexec.adapters.files.mavlink_ftp import MavlinkFtpFiles
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.clock import SystemClock
from panoexec.errors import PhotoFileError
from panoexec.sim import settings
from panoexec.sim.config import SimConfig
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator


@asynccontextmanager
async def _files(card: Path, *, max_bytes: int = 1 << 20) -> AsyncIterator[tuple[MavlinkFtpFiles, list[bool]]]:
    port, burst = free_udp_port(), [False]
    simulation = settings.changed(SimConfig(port=port, output=card), ["camera.files=mftp"])
    async with (
        running_simulator(simulation),
        MavsdkLink(f"udpin://127.0.0.1:{port}", clock=SystemClock()) as link,
    ):
        await link.wait_autopilot(60)
        yield (
            MavlinkFtpFiles(lambda: link, component=lambda: 100, burst=lambda: burst[0], max_bytes=max_bytes),
            burst,
        )


async def test_files_come_whole_packet_by_packet_and_in_bursts_and_odd_ones_are_refused(tmp_path: Path) -> None:
    card, part = tmp_path / "card", tmp_path / ".incoming" / "0-1-1"
    card.mkdir()
    part.parent.mkdir()
    data = random.Random(1).randbytes(20_001)  # not a multiple of a packet
    (card / "IMG_1.jpg").write_bytes(data)
    (card / "IMG_2.jpg").write_bytes(bytes(60_000))
    async with _files(card, max_bytes=50_000) as (files, burst):
        for in_bursts in (False, True):
            burst[0] = in_bursts
            for url in ("mftp://;comp=100/DCIM/IMG_1.jpg", "ftp:///DCIM/IMG_1.jpg"):
                assert files.takes(url)
                assert await files.fetch(url, part) == part
                assert part.read_bytes() == data
                part.unlink()
        assert not list(part.parent.iterdir())
        with pytest.raises(PhotoFileError, match="no such file") as gone:
            await files.fetch("mftp:///DCIM/IMG_3.jpg", part)
        assert not gone.value.final, "it may not be written yet"
        with pytest.raises(PhotoFileError, match="has 60000 bytes, at most 50000") as large:
            await files.fetch("mftp:///DCIM/IMG_2.jpg", part)
        assert large.value.final
        assert not part.exists()
