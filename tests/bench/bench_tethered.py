"""A tethered camera by libgphoto2: how soon its shutter is released, its files are here, and what they cost."""

from __future__ import annotations

import asyncio
import itertools
import math
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

from panoexec.adapters.camera.tethered.camera import TetheredCamera
from panoexec.clock import SystemClock
from panoexec.devices import EvidenceLevel
from panoexec.sim import settings
from panoexec.sim.config import SimConfig
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.bench.harness import Measurement
from tests.support.tethered import tethered_camera
from tests.system.daemon import SMALL, ground_station, ready, serving
from tests.waiting import eventually
from tests.wire.broker import running_broker

TRIGGERS = 100
FILES = 10
FILE_BYTES = 10_000_000
MOST_TRIGGER_S = 0.025
MOST_FILE_S = 0.3
MOST_MB = 40.0
MISSIONS = 3
MISSION_KB = 8000
MOST_RATIO = 1.02
_WITHOUT = """
from panoexec.adapters.camera.tethered.camera import TetheredCamera
from panoexec.adapters.camera.tethered.files import PhotoFiles
PhotoFiles.want = lambda *_: None
TetheredCamera.takes = lambda *_: False
"""
"""Leaves every photo in the camera."""


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
    # what else the machine does delays a shot now and then: each counts as in the mission where it was quickest
    times: dict[str, list[dict[object, float]]] = {"": [], _WITHOUT: []}
    for _ in range(MISSIONS):
        for without, found in times.items():
            found.append(asyncio.run(_flown_s(without)))
    shots = set.intersection(*(set(flown) for found in times.values() for flown in found))
    ours, theirs = (sum(min(flown[shot] for flown in found) for shot in shots) for found in times.values())
    yield Measurement(
        what=f"mission whose photos of {MISSION_KB / 1000:g} MB are copied in flight, each shot's best of {MISSIONS}",
        ours=ours,
        unit="s",
        peer="the same with the photos left in the camera",
        theirs=theirs,
        goal=f"at most {MOST_RATIO:g} times",
        met=ours <= MOST_RATIO * theirs,
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


async def _flown_s(without: str) -> dict[object, float]:
    """Seconds of each shot of a mission, from slew to slew, at real speed; the content is not examined."""
    with tempfile.TemporaryDirectory() as name:
        folder, port = Path(name), free_udp_port()
        simulation = settings.changed(
            SimConfig(port=port, output=folder / "card", camera_link="gphoto2", camera_port=0),
            [f"camera.file_kb={MISSION_KB}", "camera.render_width_px=160"],
        )
        with running_broker(folder) as broker:
            async with running_simulator(simulation) as simulator, ground_station(broker) as ground:
                more = (
                    f'[camera]\ntrigger = "gphoto2"\nport = "{simulator.ready["camera"]}"\n'
                    '[pictures]\ncheck = "off"\nthumbnails = "off"\n'
                )
                async with serving(folder, broker, port, more=more, speedup=1.0, without=without):
                    await ready(ground)
                    await ground.ask("start", "s", **SMALL)
                    await ground.until(lambda: ground.state["state"] == "complete")
                    stored = ground.types().count("photo_stored")
                    assert bool(stored) == (not without), "photos came, or not, as they should"
                    at_s: dict[object, float] = {}
                    for event in ground.events:
                        if event["type"] in {"shot_started", "mission_finishing"}:
                            at_s.setdefault(event.get("shot"), float(event["clock_s"]))  # a retake is of its shot
                    pairs = itertools.pairwise(at_s.items())
                    return {shot: later - earlier for (shot, earlier), (_, later) in pairs}
