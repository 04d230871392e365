"""A camera that speaks PTP/IP on loopback, with faults of real ones, and the truth about each of its photos."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path

from panoexec.sim.tethered.card import Card
from panoexec.sim.tethered.ptp import Answer, Op, Told
from panoexec.sim.tethered.ptpip import PtpIpServer
from panoexec.sim.tethered.responder import Responder, usual_properties


def small_jpeg(label: str, size_bytes: int = 20_000) -> bytes:
    """The outline of a JPEG, with a comment that tells which photo it is; not an image that could be shown."""
    text = label.encode()
    comment = b"\xff\xfe" + (len(text) + 2).to_bytes(2, "big") + text
    return b"\xff\xd8\xff\xe0\x00\x04\x00\x00" + comment + bytes(max(0, size_bytes - len(comment) - 10)) + b"\xff\xd9"


@dataclass(slots=True)
class TestCamera:
    """The camera and what is wrong with it.

    Attributes:
        label: what the next photo shows; noted when the shutter opens.
        shown: label by file name: the truth.
        triggers: time.monotonic of the arrival of each trigger.
        lose: fraction of the events that are lost.
        delay_s: from the trigger to the file.
        raw: `first` or `last`: a RAW file beside each JPEG; "": none.
        size_bytes: of a photo.
    """

    folder: Path
    label: str = ""
    shown: dict[str, str] = field(default_factory=dict)
    triggers: list[float] = field(default_factory=list)
    lose: float = 0.0
    delay_s: float = 0.02
    raw: str = ""
    size_bytes: int = 20_000
    refuse: Answer | None = None
    told_bytes: int | None = None
    seed: int = 1
    busy_s: float = 0.0
    card: Card = field(default_factory=Card)
    server: PtpIpServer = field(init=False)
    port: int = 0
    answers: bool = True
    lost_events: int = 0
    _random: random.Random = field(init=False)
    _timers: set[asyncio.TimerHandle] = field(default_factory=set)
    _ready_s: float = 0.0
    _asked: str = ""

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)
        properties = {one.code: one for one in usual_properties(15.0)}
        responder = Responder(card=self.card, shoot=self._shoot, properties=properties, model="test camera")
        self.server = PtpIpServer(responder, on_operation=self._operation)

    @property
    def address(self) -> str:
        """As `[camera] port` has it."""
        return f"ptpip:127.0.0.1:{self.port}:{self.port}"

    async def stall(self, seconds: float) -> None:
        """Answer nothing for a while; what was asked meanwhile is done afterwards."""
        self.server.stalled.clear()
        await asyncio.sleep(seconds)
        self.server.stalled.set()

    def _operation(self, code: int) -> None:
        if code == Op.INITIATE_CAPTURE:
            self.triggers.append(time.monotonic())
            self._asked = self.label

    def _shoot(self) -> Answer:
        if self.refuse is not None:
            return self.refuse
        now_s = time.monotonic()
        if now_s < self._ready_s:
            return Answer.DEVICE_BUSY
        self._ready_s = now_s + self.busy_s
        label = self._asked
        asyncio.get_running_loop().call_later(self.delay_s, self._done, label)
        return Answer.OK

    def _done(self, label: str) -> None:
        number = len(self.shown) + 1
        stem = f"IMG_{number:05d}"
        path = self.folder / f"{stem}.JPG"
        path.write_bytes(small_jpeg(f"{label}#{number}", self.size_bytes))
        self.shown[path.name] = label
        names = [path.name]
        if self.raw:
            names.insert(0 if self.raw == "first" else 1, f"{stem}.NEF")
        for name in names:
            if name != path.name:
                (self.folder / name).write_bytes(b"II*\0" + bytes(5000))
            added = self.card.add_file(self.folder / name, name=name, time_s=time.time(), size_bytes=self.told_bytes)
            if self._random.random() < self.lose:
                self.lost_events += 1
            else:
                self.server.tell(Told.OBJECT_ADDED, added.handle)
        self.server.tell(Told.CAPTURE_COMPLETE)


@asynccontextmanager
async def tethered_camera(folder: Path, **faults: object) -> AsyncIterator[TestCamera]:
    """A camera while the block runs; its files are in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)  # noqa: ASYNC240
    camera = TestCamera(folder, **faults)  # type: ignore[arg-type]
    camera.port = await camera.server.start("127.0.0.1", camera.port)
    try:
        yield camera
    finally:
        await camera.server.stop()
