"""A camera on MAVLink with a clock and messages of its own, behind the real `MavsdkCamera`, in virtual time.

`FakeLink` stands for the link: it carries messages and commands with delays, and loses some. `DoubtfulCamera` takes the
photos, keeps the truth about them, and reports them late, twice, out of order or not at all.
"""

from __future__ import annotations

import asyncio
import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

from panoexec.adapters.camera.camera_choice import CAPTURES_IMAGES
from panoexec.adapters.camera.camera_discovery import CAMERA_INFORMATION
from panoexec.adapters.camera.mavsdk_camera import MavsdkCamera
from panoexec.adapters.camera.photo_recall import CAPTURE_STATUS, IMAGE_CAPTURED
from panoexec.adapters.link.mavsdk_requests import REQUEST_MESSAGE
from panoexec.adapters.link.message_hub import Handler, MavMessage
from panoexec.errors import DeviceError
from tests.unit.fakes.virtual import VirtualClock

COMPONENT = 100


@dataclass(frozen=True, kw_only=True)
class Habits:
    """How a camera behaves; probabilities are per photo.

    Attributes:
        rate: camera seconds per second.
        step_s: by how much its clock is stepped once, and at which photo.
        latency_s: from the command to the exposure.
        deferred: the photo is taken seconds later than commanded.
        skipped: the command is accepted, and no photo is taken.
        lost, late, twice: the report is lost, seconds late, or repeated.
        strangers: somebody else takes a photo as well.
        jump: the image index jumps, and by up to how much.
        silent_requests: a request to the camera is not answered.
        reports: whether it reports photos at all.
        first_report_s: reports before this time are lost.
    """

    rate: float = 1.0
    step_s: float = 0.0
    step_at: int = 5
    latency_s: float = 0.05
    exposure_s: float = 0.02
    deferred: float = 0.0
    skipped: float = 0.0
    lost: float = 0.0
    late: float = 0.0
    twice: float = 0.0
    strangers: float = 0.0
    jump: float = 0.0
    jump_by: int = 5
    silent_requests: float = 0.0
    reports: bool = True
    first_report_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class TruePhoto:
    """What the camera really took."""

    number: int
    index: int
    triggered_s: float
    """When it was commanded; NaN for a stranger's."""
    exposed_s: float
    ended_s: float
    stamp_s: float

    @property
    def file(self) -> str:
        return f"mav://{self.number:04d}.jpg"


@dataclass
class DoubtfulCamera:
    """The camera itself."""

    clock: VirtualClock
    habits: Habits
    rng: random.Random
    group: asyncio.TaskGroup
    photos: list[TruePhoto] = field(default_factory=list)
    handlers: dict[str, list[Handler]] = field(default_factory=dict)
    _index: int = 0
    _offset_s: float = 500.0
    _tasks: set[asyncio.Task[None]] = field(default_factory=set)

    def stop(self) -> None:
        """Forget what is under way."""
        for task in tuple(self._tasks):
            task.cancel()

    def later(self, delay_s: float, call: Callable[[], None]) -> None:
        async def wait() -> None:
            await self.clock.sleep(delay_s)
            call()

        task = self.group.create_task(wait(), name="doubtful camera")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def boot_s(self) -> float:
        return self._offset_s + self.habits.rate * (self.clock.monotonic() - 1000.0)

    def dispatch(self, name: str, fields: dict[str, Any]) -> MavMessage:
        message = MavMessage(name, COMPONENT, fields, self.clock.monotonic())
        for handler in self.handlers.get(name, ()):
            handler(message)
        return message

    def status(self) -> dict[str, Any]:
        return {"time_boot_ms": round(1000 * self.boot_s()), "image_count": len(self.photos)}

    def command(self, triggered_s: float) -> None:
        """Obey a photo command, or not quite."""
        habits, rng = self.habits, self.rng
        if rng.random() < habits.strangers:
            self.later(rng.uniform(0.0, 3.0), lambda: self.expose(math.nan))
        if rng.random() < habits.skipped:
            return
        deferred_s = rng.uniform(0.2, 4.0) if rng.random() < habits.deferred else 0.0
        self.later(habits.latency_s + deferred_s, lambda: self.expose(triggered_s))

    def expose(self, triggered_s: float) -> None:
        habits, rng, now_s = self.habits, self.rng, self.clock.monotonic()
        if len(self.photos) == habits.step_at:
            self._offset_s += habits.step_s
        self._index += 1
        if rng.random() < habits.jump:
            self._index = max(0, self._index + rng.randint(-habits.jump_by, habits.jump_by))
        photo = TruePhoto(
            number=len(self.photos),
            index=self._index,
            triggered_s=triggered_s,
            exposed_s=now_s,
            ended_s=now_s + habits.exposure_s,
            stamp_s=self.boot_s(),
        )
        self.photos.append(photo)
        if not habits.reports or rng.random() < habits.lost:
            return
        delay_s = habits.exposure_s + rng.uniform(0.03, 0.3)
        if rng.random() < habits.late:
            delay_s += rng.uniform(0.5, 8.0)
        for again in range(2 if rng.random() < habits.twice else 1):
            self.later(delay_s + again * rng.uniform(0.0, 2.0), lambda: self.report(photo))

    def report(self, photo: TruePhoto) -> None:
        if self.clock.monotonic() - 1000.0 >= self.habits.first_report_s:
            self.dispatch(
                "CAMERA_IMAGE_CAPTURED",
                {
                    "time_boot_ms": round(1000 * photo.stamp_s),
                    "time_utc": 0,
                    "lat": 0,
                    "lon": 0,
                    "alt": 0,
                    "image_index": photo.index,
                    "capture_result": 1,
                    "file_url": photo.file,
                },
            )


class FakeLink:
    """What `MavsdkCamera` needs of `MavsdkLink`, and of its requests."""

    heartbeat_age_s = 0.0
    is_ardupilot = True
    connected = True

    def __init__(self, camera: DoubtfulCamera) -> None:
        self.camera = camera
        self.clock = camera.clock
        self.components: dict[int, tuple[int, float]] = {}
        self.requests = self

    def on(self, name: str, handler: Handler) -> Callable[[], None]:
        self.camera.handlers.setdefault(name, []).append(handler)
        return lambda: None

    def when_attached(self, callback: Callable[[], None]) -> Callable[[], None]:
        callback()
        return lambda: None

    def post(self, callback: Callable[..., None], *args: object) -> None:
        asyncio.get_running_loop().call_soon(callback, *args)

    def plugin(self, kind: object) -> Any:
        del kind
        information = SimpleNamespace(
            component_id=COMPONENT,
            vendor_name="Doubtful",
            model_name="1",
            horizontal_resolution_px=6000,
            vertical_resolution_px=4000,
            focal_length_mm=math.nan,
        )
        listed = SimpleNamespace(cameras=[information])
        return SimpleNamespace(
            subscribe_camera_list=lambda callback: callback(listed, None),
            unsubscribe_camera_list=lambda handle: None,
            take_photo=lambda component: self.camera.command(self.clock.monotonic()),
        )

    async def mavsdk_call(self, what: str, call: Callable[[], Any]) -> Any:
        del what
        await self.clock.sleep(0.002)
        call()
        await self.clock.sleep(self.camera.rng.uniform(0.005, 0.03))
        return self.clock.monotonic()

    async def command(self, command: int, params: Sequence[float] = (), *, component: int = 1) -> int:
        del command, component
        camera, (wanted, *more) = self.camera, params
        if wanted == CAMERA_INFORMATION:
            self.camera.dispatch("CAMERA_INFORMATION", camera.status() | {"flags": CAPTURES_IMAGES})
            return 0
        await self._reached()
        camera.dispatch("COMMAND_ACK", {"command": REQUEST_MESSAGE, "result": 0})
        delay_s = camera.rng.uniform(0.005, 0.04)
        if wanted == CAPTURE_STATUS:
            fields = camera.status()
            camera.later(delay_s, lambda: self._heard("CAMERA_CAPTURE_STATUS", fields))
        elif wanted == IMAGE_CAPTURED and camera.habits.reports:
            known = [photo for photo in camera.photos if photo.index == more[0]]
            if known:
                camera.later(delay_s, lambda: camera.report(known[-1]))
        return 0

    async def message(self, message_id: int, name: str, *, component: int = 1, timeout_s: float = 2.0) -> MavMessage:
        del message_id, component, timeout_s
        await self._reached()
        fields = self.camera.status()
        await self.clock.sleep(self.camera.rng.uniform(0.005, 0.04))
        return self.camera.dispatch(name, fields)

    def _heard(self, name: str, fields: dict[str, Any]) -> None:
        self.camera.dispatch(name, fields)

    async def _reached(self) -> None:
        if self.camera.rng.random() < self.camera.habits.silent_requests:
            await self.clock.sleep(2.0)
            raise DeviceError("the camera did not answer")
        await self.clock.sleep(0.01)


class CameraUnderTest(MavsdkCamera):
    """The real adapter, and the truth behind it.

    Attributes:
        true: the camera behind it.
    """

    def __init__(self, camera: DoubtfulCamera) -> None:
        super().__init__(FakeLink(camera))  # type: ignore[arg-type]
        self.true = camera
