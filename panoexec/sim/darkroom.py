"""Develops the simulated camera's photos in a process of its own, so that rendering never delays a message.

`Darkroom` is the client, inside the simulator's event loop; `python -m panoexec.sim.darkroom` is the worker: one JSON
object a line in (a job), one out (its result); it ends when its standard input ends, however its parent died.
"""

from __future__ import annotations

import asyncio
import dataclasses
import json
import os
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from panoexec.errors import DeviceError
from panoexec.optics import Camera

_NICENESS = 5
_LINE_LIMIT = 1 << 20


@dataclass(frozen=True, slots=True, kw_only=True)
class Negative:
    """An exposed photo, ready to be developed.

    Attributes:
        path: where the JPEG goes.
        truth_deg: true (yaw, roll, pitch) of the camera, evenly spaced over the exposure.
        measured_deg: (yaw, roll, pitch) as the camera was told; goes into the JPEG's metadata.
        index: running number.
        time_utc_s: start of the exposure.
        exposure_s: shutter time.
        latitude_deg, longitude_deg, altitude_m, relative_altitude_m: where.
    """

    path: str
    truth_deg: tuple[tuple[float, float, float], ...]
    measured_deg: tuple[float, float, float]
    index: int
    time_utc_s: float
    exposure_s: float
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    relative_altitude_m: float


class Darkroom:
    """Sends negatives to the worker and keeps count.

    Attributes:
        pending: photos not yet on disk.
        failures: what went wrong, one line each.
    """

    def __init__(
        self, camera: Camera, width_px: int, *, scene: Path | None, seed: int, on_written: Callable[[str], None]
    ) -> None:
        self._setup = {
            "camera": dataclasses.asdict(camera),
            "width_px": width_px,
            "scene": str(scene) if scene else None,
            "seed": seed,
        }
        self._on_written = on_written
        self._process: asyncio.subprocess.Process | None = None
        self._idle = asyncio.Event()
        self._idle.set()
        self.pending = 0
        self.failures: list[str] = []

    async def start(self) -> None:
        """Start the worker; it prepares the scene while the vehicle boots."""
        self._process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "panoexec.sim.darkroom",
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            limit=_LINE_LIMIT,
        )
        self._send(self._setup)

    def develop(self, negative: Negative) -> None:
        """Queue one photo; returns at once."""
        self.pending += 1
        self._idle.clear()
        self._send(dataclasses.asdict(negative))

    def _send(self, document: dict[str, Any]) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(document).encode() + b"\n")

    async def run(self) -> None:
        """Read the worker's results until it ends.

        Raises:
            DeviceError: it ended with photos still to develop.
        """
        assert self._process is not None
        assert self._process.stdout is not None
        while line := await self._process.stdout.readline():
            result = json.loads(line)
            if error := result.get("error"):
                self.failures.append(error)
            else:
                self._on_written(result["path"])
            self.pending -= 1
            if not self.pending:
                self._idle.set()
        self._idle.set()
        if self.pending:
            raise DeviceError(f"the simulated camera's renderer ended with {self.pending} photos not written")

    async def drain(self, timeout_s: float) -> bool:
        """Wait until every photo is on disk; False if that took longer than `timeout_s`."""
        try:
            async with asyncio.timeout(timeout_s):
                await self._idle.wait()
        except TimeoutError:
            return False
        return True

    async def close(self) -> None:
        """End the worker and wait for it."""
        process = self._process
        if process is None or process.returncode is not None:
            return
        assert process.stdin is not None
        process.stdin.close()
        try:
            async with asyncio.timeout(3.0):
                await process.wait()
        except TimeoutError:
            process.kill()
            await process.wait()


def _work() -> None:
    """The worker: develop jobs from standard input until it ends."""
    os.nice(_NICENESS)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides when this ends
    from panoexec.angles import rotation  # noqa: PLC0415  (the client needs neither numpy nor Pillow)
    from panoexec.sim.render import Renderer  # noqa: PLC0415
    from panoexec.sim.scene import load_scene, procedural_scene  # noqa: PLC0415

    first = sys.stdin.readline()
    if not first:
        return
    setup = json.loads(first)
    camera = Camera(**setup["camera"])
    scene = load_scene(Path(setup["scene"])) if setup["scene"] else procedural_scene(setup["seed"])
    renderer = Renderer(scene)
    for line in sys.stdin:
        job = json.loads(line)
        started = time.monotonic()
        path = Path(job["path"])
        try:
            truth = job["truth_deg"]
            poses = rotation([t[0] for t in truth], [t[2] for t in truth], [t[1] for t in truth])
            pixels = renderer.render(camera, poses, setup["width_px"])
            _write(path, pixels, job, camera)
        except OSError as error:
            result = {"path": job["path"], "error": f"{path}: cannot write the photo: {error.strerror or error}"}
        else:
            result = {"path": job["path"], "seconds": round(time.monotonic() - started, 4)}
        print(json.dumps(result), flush=True)


def _write(path: Path, pixels: Any, job: dict[str, Any], camera: Camera) -> None:
    from PIL import Image  # noqa: PLC0415

    del job, camera
    temporary = path.with_suffix(".part")
    Image.fromarray(pixels).save(temporary, "JPEG", quality=90)
    temporary.replace(path)


if __name__ == "__main__":
    _work()
