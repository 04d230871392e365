"""Files of a MAVLink camera over HTTP: what a transfer costs, and whether it slows a mission down."""

from __future__ import annotations

import asyncio
import random
import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from panoexec.adapters.files.http_files import HttpFiles
from panoexec.sim import settings
from panoexec.sim.config import SimConfig
from panoexec.sim.photos.file_server import serving_photos
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from panoexec.store.photo_store import hash_file
from tests.bench.harness import Measurement
from tests.system.daemon import SMALL, ground_station, ready, serving
from tests.wire.broker import running_broker

_MISSIONS = 2
_PHOTO_BYTES = 10_000_000
_MOST_MB = 45.0
_MOST_RATIO = 1.02
_MOST_S = 0.3


def measure() -> Iterator[Measurement]:
    """Transfer and hash 10 MB; fly missions with and without transfer, in turns, without the check of content."""
    with tempfile.TemporaryDirectory() as folder:
        fetched_s, hashed_s, peak_mb = asyncio.run(_transferred(Path(folder)))
    yield Measurement(
        what="10 MB fetched from loopback and hashed, median of five",
        ours=fetched_s + hashed_s,
        unit="s",
        goal=f"at most {_MOST_S:g}",
        met=fetched_s + hashed_s <= _MOST_S,
    )
    yield Measurement(
        what="memory of the process that downloads, peak",
        ours=peak_mb,
        unit="MB",
        goal=f"at most {_MOST_MB:g}",
        met=peak_mb <= _MOST_MB,
    )
    times: dict[str, list[float]] = {"http": [], "folder": []}
    for _ in range(_MISSIONS):
        for files, found in times.items():
            found.append(asyncio.run(_flown_s(files)))
    ours, theirs = min(times["http"]), min(times["folder"])
    yield Measurement(
        what="mission whose photos are fetched in flight, best of two",
        ours=ours,
        unit="s",
        peer="the same without transfer",
        theirs=theirs,
        goal=f"at most {_MOST_RATIO:g} times",
        met=ours <= _MOST_RATIO * theirs,
    )


async def _transferred(folder: Path) -> tuple[float, float, float]:
    """Seconds to fetch and to hash (medians), and peak memory in MB; the first fetch starts the process."""
    (folder / "1.jpg").write_bytes(random.Random(1).randbytes(_PHOTO_BYTES))
    fetched, hashed = [], []
    with serving_photos(folder) as base:
        files = HttpFiles(lambda: ["127.0.0.1"])
        try:
            for number in range(6):
                began = time.monotonic()
                path = await files.fetch(f"{base}/1.jpg", folder / f"part{number}")
                fetched.append(time.monotonic() - began)
                began = time.monotonic()
                await asyncio.to_thread(hash_file, path)
                hashed.append(time.monotonic() - began)
            assert files._process is not None
            status = Path(f"/proc/{files._process.pid}/status").read_text(encoding="ascii")  # noqa: ASYNC240
        finally:
            await files.close()
    peak_kb = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))
    return statistics.median(fetched[1:]), statistics.median(hashed[1:]), peak_kb / 1000


async def _flown_s(files: str) -> float:
    """Seconds of a mission of seven shots or more, from its first slew to its last verdict, at real speed."""
    with tempfile.TemporaryDirectory() as name:
        folder, port = Path(name), free_udp_port()
        simulation = settings.changed(
            SimConfig(port=port, output=folder / "card"), [f"camera.files={files}", "camera.render_width_px=1600"]
        )
        more = '[camera]\nfile_hosts = ["127.0.0.1"]\n[pictures]\ncheck = "off"\n'
        with running_broker(folder) as broker:
            async with (
                running_simulator(simulation),
                ground_station(broker) as ground,
                serving(folder, broker, port, more=more, speedup=1.0),
            ):
                await ready(ground)
                await ground.ask("start", "s", **SMALL)
                await ground.until(lambda: ground.state["state"] == "complete")
                at = {kind: [e["clock_s"] for e in ground.events if e["type"] == kind] for kind in ground.types()}
                return float(at["mission_finishing"][0] - at["shot_started"][0])
