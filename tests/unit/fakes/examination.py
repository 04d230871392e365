"""A mission whose photos a scripted examination judges, for tests of `ContentCheck`."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Collection, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from panoexec.errors import DeviceError
from panoexec.mission.content_check import ContentCheck, PictureSource
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.shot_queue import ShotQueue
from panoexec.optics import Camera
from panoexec.pictures.model import BridgePose, Content, Judgement, TieGraph, TieLine, Verdicts
from panoexec.planning.model import GimbalLimits, Shot

SHOTS = tuple(Shot(index=k, row=0, pitch_deg=-30.0, yaw_deg=60.0 * k - 180) for k in range(6))


class Checker:
    """A scripted examination."""

    def __init__(self) -> None:
        self.bad: dict[int, Content] = {}
        self.added: list[int] = []
        self.broken = False
        self.wished: list[BridgePose] = []
        self.edges: tuple[tuple[int, int, int], ...] = ()
        self.limits: tuple[float, float] | None = None

    async def plan(self, planned: Mapping[int, Sequence[float]]) -> None:
        self.planned = dict(planned)

    async def add(
        self, shot: int, path: Path, q_wxyz: Sequence[float], time_s: float, place: Sequence[float] | None = None
    ) -> Verdicts:
        del path, q_wxyz, time_s, place
        if self.broken:
            raise DeviceError("gone")
        self.added.append(shot)
        return await self.judge()

    async def condemn(self, shot: int, code: Content, reason: str, q_wxyz: Sequence[float], time_s: float) -> Verdicts:
        del reason, q_wxyz, time_s
        self.bad[shot] = code
        self.added.append(shot)
        return await self.judge()

    async def drop(self, shots: Sequence[int]) -> Verdicts:
        self.added = [shot for shot in self.added if shot not in shots]
        return await self.judge()

    async def judge(self, *, final: bool = False) -> Verdicts:
        del final
        photos = {
            shot: Judgement(
                shot=shot,
                verdict=self.bad.get(shot, Content.OK),
                reason="bad" if shot in self.bad else "",
                ties=(TieLine(shot=0, points=9, angle_deg=0.1),),
            )
            for shot in self.added
        }
        good = tuple(shot for shot in photos if shot not in self.bad)
        graph = TieGraph(photos=good, groups=(good,) if good else (), edges=self.edges)
        return Verdicts(photos=photos, graph=graph)

    async def bridges(
        self, *, tried: Collection[frozenset[int]], pitch_deg: tuple[float, float], most: int
    ) -> list[BridgePose]:
        self.limits = pitch_deg
        return [one for one in self.wished if frozenset(one.between) not in tried][:most]


class Mission:
    """What the check needs of a mission: a record with accepted photos, and a recorder."""

    def __init__(self, folder: Path, pictures: str = "retake") -> None:
        from types import SimpleNamespace  # noqa: PLC0415

        self.record = MissionRecord(mission_id="m", shots=SHOTS)
        self.events: list[ev.Event] = []
        self.revoked: list[tuple[int, int, str]] = []
        self.folder = folder
        self.checker = Checker()
        requests = SimpleNamespace(stop=None, must_end_shooting=False)
        self.requests = requests
        from panoexec.clock import SystemClock  # noqa: PLC0415

        self.context = SimpleNamespace(
            record=self.record,
            plan=SimpleNamespace(camera=Camera.from_fov(60, 45)),
            settings=SimpleNamespace(pictures=pictures, gimbal=GimbalLimits(pitch_min_deg=-70.0)),
            gimbal=SimpleNamespace(limits=None),
            recorder=SimpleNamespace(emit=self.emit),
            requests=requests,
            queue=ShotQueue([], attempts=9, rounds=9),
            clock=SystemClock(),
        )
        self.check = ContentCheck(
            self.context,  # type: ignore[arg-type]
            PictureSource(folder=folder, open=self.opened),
            self.revoke,
        )

    @asynccontextmanager
    async def opened(self, camera: Camera) -> AsyncIterator[Checker]:
        del camera
        yield self.checker

    def emit(self, event: ev.Event) -> ev.Event:
        stamped = replace(event, seq=self.record.seq + 1, mission_id="m", time_utc_s=0.0, clock_s=0.0)
        self.record.apply(stamped)
        self.events.append(stamped)
        return stamped

    def revoke(self, shot: int, number: int, code: str, reason: str, photos: tuple[ev.Photo, ...]) -> None:
        self.revoked.append((shot, number, code))
        self.context.queue.add(shot)
        self.emit(ev.ShotRevoked(shot=shot, attempt=number, code=code, reason=reason, photos=photos))

    def accept(self, shot: int, *, stored: bool = True, taken_s: float = math.nan) -> None:
        self.context.queue.clear()
        number = len(self.record.shots[shot].attempts) + 1
        self.emit(ev.ShotStarted(shot=shot, attempt=number, round=0, pitch_deg=0.0, yaw_deg=0.0, patience_s=1.0))
        self.emit(
            ev.ShotExposed(
                shot=shot, attempt=number, photos=(), pointing_ok=True, reason="", samples=1, measured=None,
                errors=None, slew_settle_s=0.0, trigger_delay_s=0.0,
            )
        )  # fmt: skip
        self.emit(ev.ShotAccepted(shot=shot, attempt=number, photos=(), by="tolerance"))
        if stored:
            name = f"images/{shot}-{number}.jpg"
            (self.folder / "images").mkdir(exist_ok=True)
            (self.folder / name).write_bytes(b"x")
            self.emit(
                ev.PhotoStored(
                    shot=shot,
                    attempt=number,
                    file=name,
                    size_bytes=1,
                    sha256=f"{shot}{number}" * 32,
                    source="local",
                    taken_s=taken_s,
                    taken_resolution_s=1.0,
                )
            )

    async def checked(self) -> None:
        """Examine everything that is here, and judge it."""
        self.check._ended = False
        running = asyncio.create_task(self.check.run())
        try:
            while self.check._checker is None:  # noqa: ASYNC110
                await asyncio.sleep(0)
            await self.check.settle()
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)

    def kinds(self) -> list[str]:
        return [event.type for event in self.events]


def be_quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait for files for moments."""
    monkeypatch.setattr("panoexec.mission.content_check._LOOK_S", 0.001)
    monkeypatch.setattr("panoexec.mission.content_check._NO_FILE_S", 0.05)
    monkeypatch.setattr("panoexec.mission.content_check._NO_MORE_S", 0.05)
