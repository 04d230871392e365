"""Renders the simulated camera's photos in a separate process, so that rendering never delays a message.

`Darkroom` is the client in the simulator's event loop; `python -m panoexec.sim.photos.darkroom` is the worker: it reads
one JSON object per line (a job) and writes one per line (its result); it exits at the end of its standard input, so it
never outlives its parent.
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

from panoexec.errors import DeviceError, PanoexecError, UsageError
from panoexec.files import write_atomically
from panoexec.optics import Camera

_NICENESS = 5
_LINE_LIMIT = 1 << 20


@dataclass(frozen=True, slots=True, kw_only=True)
class ExposedPhoto:
    """An exposed photo, ready to be rendered.

    Attributes:
        path: the JPEG file to write.
        truth_deg: true (yaw, roll, pitch) of the camera, evenly spaced over the exposure.
        q_wxyz: attitude as reported to the camera, relative to north; for the JPEG's metadata.
        time_utc_s: start of the exposure.
        exposure_s: shutter time.
        position: (latitude, longitude, altitude, altitude above home) in degrees and metres, None without a fix.
        flight_yaw_deg: the vehicle's heading, None if unknown.
        spoils: (fault, size, seed) of what spoils picture or file (`panoexec.sim.photos.spoiling`).
        is_stale: the file is the previous one's again.
        f_number, iso, manual_white_balance: further settings, for the JPEG's metadata.
    """

    path: str
    truth_deg: tuple[tuple[float, float, float], ...]
    q_wxyz: tuple[float, float, float, float]
    time_utc_s: float
    exposure_s: float
    position: tuple[float, float, float, float] | None
    flight_yaw_deg: float | None
    spoils: tuple[tuple[str, float, int], ...] = ()
    is_stale: bool = False
    f_number: float = 5.6
    iso: int = 100
    manual_white_balance: bool = False


class Darkroom:
    """Sends photos to the worker and counts the results.

    Attributes:
        written: photos on disk.
        pending: photos not yet on disk.
        failures: error messages, one line each.
        on_written: called with the path of each photo that is on disk.
    """

    def __init__(
        self,
        camera: Camera,
        width_px: int,
        *,
        scene: Path | None,
        seed: int,
        scene_kind: str = "city",
        file_kb: float = 0.0,
    ) -> None:
        self._setup = {
            "camera": dataclasses.asdict(camera),
            "width_px": width_px,
            "scene": str(scene) if scene else None,
            "seed": seed,
            "scene_kind": scene_kind,
            "file_kb": file_kb,
        }
        self._process: asyncio.subprocess.Process | None = None
        self._idle = asyncio.Event()
        self._idle.set()
        self.written = 0
        self.pending = 0
        self.failures: list[str] = []
        self.on_written: Callable[[str], None] = lambda _: None

    async def start(self, *, wait: bool = False) -> None:
        """Start the worker; wait for it only if the scene is a file, which may be invalid, or if that is asked for.

        Raises:
            UsageError: the scene is not an equirectangular image; the message names it.
        """
        self._process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "panoexec.sim.photos.darkroom",
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            limit=_LINE_LIMIT,
        )
        self._send(self._setup)
        if wait or self._setup["scene"] is not None:
            first = json.loads(await self._stdout().readline() or '{"error": "the renderer did not start"}')
            if error := first.get("error"):
                await self.close()
                raise UsageError(error)

    def develop(self, photo: ExposedPhoto) -> None:
        """Queue one photo; returns at once."""
        self.pending += 1
        self._idle.clear()
        self._send(dataclasses.asdict(photo))

    def _stdout(self) -> asyncio.StreamReader:
        assert self._process is not None
        assert self._process.stdout is not None
        return self._process.stdout

    def _send(self, document: dict[str, Any]) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(document).encode() + b"\n")

    async def run(self) -> None:
        """Read the worker's results until cancelled.

        Raises:
            DeviceError: the worker exited unexpectedly.
        """
        while line := await self._stdout().readline():
            result = json.loads(line)
            if "path" not in result:
                if error := result.get("error"):
                    raise UsageError(error)
                continue
            if error := result.get("error"):
                self.failures.append(error)
            else:
                self.written += 1
                self.on_written(result["path"])
            self.pending -= 1
            if self.pending <= 0:
                self._idle.set()
        raise DeviceError(f"the simulated camera's renderer exited; {self.pending} photos were not written")

    async def drain(self, timeout_s: float) -> bool:
        """Wait until every photo is on disk (`run` must be running); False if that took longer than `timeout_s`."""
        try:
            async with asyncio.timeout(timeout_s):
                await self._idle.wait()
        except TimeoutError:
            return False
        return True

    async def close(self) -> None:
        """End the worker and wait for it; pending photos are discarded, and none is left half-written."""
        process = self._process
        if process is None or process.returncode is not None:
            return
        assert process.stdin is not None
        process.stdin.close()
        if self.pending:
            process.kill()
        try:
            async with asyncio.timeout(3.0):
                await process.wait()
        except TimeoutError:
            process.kill()
            await process.wait()


def _work() -> None:
    """The worker: render jobs from standard input until its end."""
    os.nice(_NICENESS)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides when to exit
    first = sys.stdin.readline()
    if not first:
        return
    setup = json.loads(first)
    try:
        renderer = _renderer(setup)
    except PanoexecError as error:
        _answer({"error": str(error)})
        return
    _answer({"ready": True})
    camera = Camera.from_plain(setup["camera"])
    last = b""
    for line in sys.stdin:
        job = json.loads(line)
        started = time.monotonic()
        try:
            last = _develop(renderer, camera, setup, job, last)
        except PanoexecError as error:
            _answer({"path": job["path"], "error": str(error)})
        else:
            _answer({"path": job["path"], "seconds": round(time.monotonic() - started, 4)})


def _answer(document: dict[str, Any]) -> None:
    print(json.dumps(document), flush=True)


def _renderer(setup: dict[str, Any]) -> Any:
    # the client needs neither the renderer nor Pillow
    from panoexec.sim.photos.render import Renderer, pixels_per_radian  # noqa: PLC0415
    from panoexec.sim.photos.scene import load_scene, procedural_scene, width_for_photos_px  # noqa: PLC0415

    if setup["scene"]:
        return Renderer(load_scene(Path(setup["scene"])))
    fine = pixels_per_radian(Camera.from_plain(setup["camera"]), setup["width_px"])
    return Renderer(procedural_scene(setup["seed"], width_for_photos_px(fine), setup["scene_kind"]))


def _develop(renderer: Any, camera: Camera, setup: dict[str, Any], job: dict[str, Any], last: bytes) -> bytes:
    """Write a photo; returns the file's content, which is `last` again for a stale one."""
    from panoexec.angles import rotation  # noqa: PLC0415
    from panoexec.formats.xmp import Position  # noqa: PLC0415
    from panoexec.sim.photos.jpeg import PhotoMetadata, jpeg_bytes, padded  # noqa: PLC0415
    from panoexec.sim.photos.spoiling import spoiled_file, spoiled_image  # noqa: PLC0415

    if job["is_stale"] and last:
        write_atomically(Path(job["path"]), last, sync=False)
        return last
    truth = job["truth_deg"]
    poses = rotation([t[0] for t in truth], [t[2] for t in truth], [t[1] for t in truth])
    place = job["position"]
    metadata = PhotoMetadata(
        time_utc_s=job["time_utc_s"],
        exposure_s=job["exposure_s"],
        focal_length_mm=camera.focal_length_mm,
        equivalent_focal_length_mm=camera.equivalent_focal_length_mm,
        q_wxyz=tuple(job["q_wxyz"]),
        position=Position(
            latitude_deg=place[0], longitude_deg=place[1], altitude_m=place[2], relative_altitude_m=place[3]
        )
        if place
        else None,
        flight_yaw_deg=job["flight_yaw_deg"],
        model=camera.name,
        f_number=job["f_number"],
        iso=job["iso"],
        manual_white_balance=job["manual_white_balance"],
    )
    image = renderer.render(camera, poses, setup["width_px"])
    for fault, size, seed in job["spoils"]:
        image = spoiled_image(image, fault, size, seed=seed)
    content = padded(jpeg_bytes(image, metadata), round(1000 * setup["file_kb"]))
    for fault, _, seed in job["spoils"]:
        content = spoiled_file(content, fault, seed=seed)
    # no fsync: a simulated photo need not survive a power loss
    write_atomically(Path(job["path"]), content, sync=False)
    return content


if __name__ == "__main__":
    _work()
