"""A tethered camera by libgphoto2: how soon its shutter is released, and its files are here, over PTP on loopback."""

from __future__ import annotations

import asyncio
import math
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

from panoexec.adapters.camera.tethered.camera import TetheredCamera
from panoexec.clock import SystemClock
from panoexec.devices import EvidenceLevel
from tests.bench.harness import Measurement
from tests.support.tethered import tethered_camera
from tests.waiting import eventually

TRIGGERS = 100
FILES = 10
FILE_BYTES = 10_000_000
MOST_TRIGGER_S = 0.025
MOST_FILE_S = 0.3
MOST_MB = 40.0


def measure() -> Iterable[Measurement]:
    """Triggers while files are copied, then files of 10 MB one by one."""
    with tempfile.TemporaryDirectory() as folder:
        trigger_s, file_s, peak_mb = asyncio.run(_measured(Path(folder)))
    yield Measurement(
        what=f"trigger on the wire after it was asked for, 99th percentile of {TRIGGERS}, files being copied",
        ours=trigger_s,
        unit="s",
        goal=f"at most {MOST_TRIGGER_S:g} s",
        met=trigger_s <= MOST_TRIGGER_S,
    )
    yield Measurement(
        what=f"photo in the camera to file on disk with its hash, less the transfer, the worst of {FILES} with 10 MB",
        ours=file_s,
        unit="s",
        goal=f"at most {MOST_FILE_S:g} s",
        met=file_s <= MOST_FILE_S,
    )
    yield Measurement(
        what="process of the camera, most memory", ours=peak_mb, unit="MB", goal="at most 40 MB", met=peak_mb <= MOST_MB
    )


async def _measured(folder: Path) -> tuple[float, float, float]:
    async with (
        tethered_camera(folder / "card", size_bytes=2_000_000) as sim,
        TetheredCamera(clock=SystemClock(), port=sim.address, spool=folder / "incoming") as camera,
    ):
        await camera.discover(60)
        delays_s = []
        for number in range(1, TRIGGERS + 1):
            asked_s = time.monotonic()
            await camera.trigger()
            delays_s.append(sim.triggers[-1] - asked_s)
            await eventually(lambda count=number: camera.image_count == count)  # type: ignore[misc]
        await eventually(lambda: not camera.files.pending)
        sim.size_bytes = FILE_BYTES
        rests_s = []
        for _ in range(FILES):
            capture = await camera.trigger()
            await capture.evidence(EvidenceLevel.CAPTURE_MESSAGE, 20)
            told_s = time.monotonic()
            await capture.evidence(EvidenceLevel.FILE_SEEN, 20)
            rests_s.append(time.monotonic() - told_s - camera.files.arrived[-1].transfer_s)
        status = Path(f"/proc/{camera.process_id}/status").read_text(encoding="ascii")  # noqa: ASYNC240
        peak_mb = int(status.split("VmHWM:")[1].split()[0]) * 1024 / 1e6
    delays_s.sort()
    return delays_s[math.ceil(0.99 * len(delays_s)) - 1], max(rests_s), peak_mb
