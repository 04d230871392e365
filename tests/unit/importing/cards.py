"""Missions and memory cards for imports: journals with plausible times, and JPEGs with EXIF."""

from __future__ import annotations

import asyncio
import io
import json
import random
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import PIL.ExifTags
import PIL.Image

from panoexec.devices import EvidenceLevel
from panoexec.inputs.plan_file import plan_to_data
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import planned_pose
from panoexec.mission.log.states import MissionState
from panoexec.store.directory import MissionDirectory, new_mission_directory
from panoexec.store.journal import SqliteJournal
from panoexec.store.journal_layout import MISSION_ID
from tests.unit.fakes.world import a_plan

BEGIN = datetime(2026, 9, 21, 14, 13, 20, tzinfo=UTC).timestamp()


@dataclass(frozen=True)
class Taken:
    """A photo that an attempt took."""

    shot: int
    attempt: int
    time_s: float
    accepted: bool


def take(count: int, *, seed: int, begin_s: float = BEGIN, every_s: tuple[float, float] = (2.4, 6.0)) -> list[Taken]:
    """Attempts at `count` shots; every eleventh is rejected once and retaken."""
    rng, now, out = random.Random(seed), begin_s, []
    for shot in range(count):
        attempts = 2 if shot % 11 == 5 and every_s[0] != every_s[1] else 1
        for attempt in range(1, attempts + 1):
            now += rng.uniform(*every_s)
            out.append(Taken(shot, attempt, now, attempt == attempts))
    return out


def a_mission(
    storage: Path, taken: Sequence[Taken], *, measured: bool = False, pitch_deg: float = -20.0
) -> MissionDirectory:
    """A finished mission whose camera told nothing but that it was triggered."""
    return asyncio.run(_written(storage, taken, measured, pitch_deg))


async def _written(storage: Path, taken: Sequence[Taken], measured: bool, pitch_deg: float) -> MissionDirectory:
    plan = a_plan(1 + max(one.shot for one in taken), pitch_deg=pitch_deg)
    directory = new_mission_directory(storage, now_utc_s=taken[0].time_s - 5)
    head = {MISSION_ID: directory.mission_id, "plan": json.dumps(plan_to_data(plan)), "settings": "{}", "extra": "{}"}
    events: list[ev.Event] = []

    def add(event: ev.Event, state: MissionState, time_s: float) -> None:
        fields = {"mission_id": directory.mission_id, "seq": len(events) + 1, "time_utc_s": time_s, "state": state}
        for name, value in fields.items():
            object.__setattr__(event, name, value)
        events.append(event)

    add(ev.MissionStarted(shots_total=len(plan.shots)), MissionState.PREFLIGHT, taken[0].time_s - 4)
    add(ev.PreflightPassed(), MissionState.CAPTURING, taken[0].time_s - 3)
    for one in taken:
        who: dict[str, Any] = {"shot": one.shot, "attempt": one.attempt}
        shot = plan.shots[one.shot]
        add(
            ev.ShotStarted(**who, round=0, pitch_deg=shot.pitch_deg, yaw_deg=shot.yaw_deg, patience_s=1),
            MissionState.CAPTURING,
            one.time_s - 1,
        )
        photo = ev.Photo(number=1, evidence=EvidenceLevel.COMMANDED, capture_time_utc_s=one.time_s)
        exposed = ev.ShotExposed(
            **who, photos=(photo,), pointing_ok=one.accepted, reason="", samples=9, errors=None,
            measured=planned_pose(shot) if measured else None,
            slew_settle_s=1.0, trigger_delay_s=0.01,
        )  # fmt: skip
        add(exposed, MissionState.CAPTURING, one.time_s + 0.1)
        if one.accepted:
            add(ev.ShotAccepted(**who, photos=(photo,)), MissionState.CAPTURING, one.time_s + 0.2)
        else:
            add(ev.ShotRejected(**who, code="pointing", reason=""), MissionState.CAPTURING, one.time_s + 0.2)
    end_s = taken[-1].time_s + 1
    add(ev.MissionFinishing(), MissionState.FINISHING, end_s)
    add(
        ev.MissionFinished(reason="", accepted=len(plan.shots), missing=(), certified=None),
        MissionState.COMPLETE,
        end_s,
    )
    journal = await SqliteJournal.create(directory.journal, head)
    await journal.append(events)
    await journal.close()
    return directory


def write_photo(path: Path, time_s: float, *, content: int, fraction: bool = False) -> None:
    """A JPEG by a clock that shows `time_s`; without a time if that is 0."""
    path.parent.mkdir(parents=True, exist_ok=True)
    exif = PIL.Image.Exif()
    exif[PIL.ExifTags.Base.Make] = "SONY"
    if time_s:
        moment = datetime.fromtimestamp(time_s, UTC)
        inner = exif.get_ifd(PIL.ExifTags.IFD.Exif)
        inner[PIL.ExifTags.Base.DateTimeOriginal] = f"{moment:%Y:%m:%d %H:%M:%S}"
        inner[PIL.ExifTags.Base.SubsecTimeOriginal] = f"{moment.microsecond // 1000:03d}" if fraction else "000"
    buffer = io.BytesIO()
    PIL.Image.new("RGB", (24, 16), (content % 256, content // 256 % 256, 40)).save(
        buffer, "JPEG", exif=exif, quality=95
    )
    path.write_bytes(buffer.getvalue() + f"{content}".encode())  # as cameras append previews


def write_raw(path: Path, content: int) -> None:
    path.write_bytes(b"II*\x00\x08\x00\x00\x00\x00\x00" + f"raw {content}".encode())


def dsc(number: int) -> str:
    """Sony's names: folders of 9999 photos, after DSC09999 comes DSC00001."""
    folder, within = divmod(number - 1, 9999)
    return f"DCIM/{100 + folder}MSDCF/DSC{within + 1:05d}.JPG"
