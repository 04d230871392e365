"""manifest.json: what was requested and what was taken, attempt by attempt (`panoexec.manifest/1`).

Attitudes are the camera's (FRD: x boresight, y right of the image, z bottom) in the plan's frame (NED whose x axis is
the plan's yaw 0): a unit quaternion `[w, x, y, z]` from camera to that frame, and the gimbal's axes in the order yaw,
roll, pitch (3-1-2): R = Rz(yaw) · Rx(roll) · Ry(pitch). This is the order of a gimbal's axes, to which tolerances
refer; at roll 0 it equals the usual 3-2-1 angles. `reference.yaw_north_deg` converts plan yaw to yaw from true north.
Errors are measured minus target (`planning.geometry.pose_error`), the largest over the exposure.

The manifest is derived from the journal: `journal.events` says up to which event. `digest` is the seal of everything
else (of the head, then of each shot, as compact JSON in the order of the document), so that damage is noticed although
the journal is not at hand, and although another program laid the text out anew.
"""

from __future__ import annotations

import asyncio
import functools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np

from panoexec.angles import rotation, rotation_from_quaternion
from panoexec.clock import Clock
from panoexec.codec import encode
from panoexec.durable.seals import seal
from panoexec.errors import InputFileError, UsageError
from panoexec.files import write_atomically
from panoexec.inputs.plan_file import camera_to_data, certificate_to_data
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.shot_record import AttemptRecord, ShotRecord
from panoexec.mission.parallax import SeamTable
from panoexec.mission.pointing.poses import pose_of, to_north
from panoexec.pictures.rotations import rotation_of_vector
from panoexec.planning.model import Certificate, Plan

FORMAT = "panoexec.manifest/1"
_CHARGE_STEP_FRAC = 0.002
CONVENTIONS = {
    "quaternion": "[w, x, y, z], camera (FRD: x boresight, y image right, z image bottom) to plan frame (NED)",
    "roll_pitch_yaw": "gimbal axes in the order yaw, roll, pitch (3-1-2): R = Rz(yaw) Rx(roll) Ry(pitch)",
    "pitch_deg": "positive up, -90 is the nadir",
    "yaw_deg": "clockwise seen from above; 0 is the plan's reference, which is reference.yaw_north_deg from true north",
    "roll_deg": "positive when the right of the image goes down",
    "error_deg": "measured minus target, the worst of the exposure; across, along, rotation: displacement in the image",
}


class ManifestWriter:
    """Keeps manifest.json up to date while a mission runs; an event sink.

    Args:
        path: the file.
        plan: the mission's plan.
        record: the mission's record, read when the file is written.
        vehicle: data on the vehicle, as JSON.
        name: what people call the mission, "" for none.
        tour: the stop of a tour that it is flown at, as JSON; None for none.
        clock: the mission's clock.
        certificate: returns the certificate of the measured attitudes; called when the file is written.
        every_s: least time between two writes while the mission runs.
        battery: returns the charge, 0 to 1 or NaN; called at each event.
    """

    def __init__(
        self,
        *,
        path: Path,
        plan: Plan,
        record: MissionRecord,
        vehicle: Mapping[str, Any],
        clock: Clock,
        certificate: Callable[[], Certificate | None],
        every_s: float = 2.0,
        battery: Callable[[], float] = lambda: math.nan,
        name: str = "",
        tour: Mapping[str, Any] | None = None,
    ) -> None:
        self._path = path
        self._plan = plan
        self._record = record
        self._vehicle = vehicle
        self._clock = clock
        self._certificate = certificate
        self._every_s = every_s
        self._battery = battery
        self._name = name
        self._tour = None if tour is None else dict(tour)
        self._charges = _earlier_charges(path)
        self._seams = SeamTable(plan.camera)
        self._dirty = asyncio.Event()
        self._events = record.seq
        self._shots: dict[int, tuple[str, bytes]] = {}

    def publish(self, event: ev.Event) -> None:
        """See `EventSink.publish`."""
        if isinstance(event, ev.ShotEvent):
            self._shots.pop(event.shot, None)
        self._events = max(self._events, event.seq)
        self._note_charge()
        self._dirty.set()

    def _note_charge(self) -> None:
        """Record the charge after a visible change; events do not contain it."""
        charge = self._battery()
        if math.isfinite(charge) and (not self._charges or abs(charge - self._charges[-1][1]) >= _CHARGE_STEP_FRAC):
            self._charges.append((self._clock.time(), charge))

    async def run(self) -> None:
        """Write after changes, at most every `every_s`; runs until cancelled.

        A failure does not end the mission, because the journal has all data: the write is retried, and the last write
        raises.
        """
        while True:
            await self._dirty.wait()
            self._dirty.clear()
            try:
                await self.write()
            except UsageError:
                self._dirty.set()
            await self._clock.sleep(self._every_s)

    async def write(self) -> None:
        """Write the file now.

        Raises:
            UsageError: the file cannot be written.
        """
        text = self.text()
        await asyncio.to_thread(write_atomically, self._path, text)

    def text(self) -> str:
        """The manifest as JSON text.

        Only shots that changed since the last call are encoded: encoding hundreds of shots every two seconds would
        dominate the daemon's CPU time.
        """
        record = self._record
        for index, shot in record.shots.items():
            if index not in self._shots:
                data = _shot_json(shot, record.reference_yaw_north_deg, self._path.parent)
                text = json.dumps(data)  # one line: three times as fast as indented, and a third shorter
                self._shots[index] = f"  {text}", seal(text)
        lines = [self._shots[index] for index in sorted(record.shots)]
        document = self._head()
        document["digest"] = _digest(document, [digest for _, digest in lines])
        head = json.dumps(document, indent=1).removesuffix("\n}")
        shots = ",\n".join(line for line, _ in lines)
        return f'{head},\n "shots": [\n{shots}\n ]\n}}\n'

    def _head(self) -> dict[str, Any]:
        """Everything except the shots."""
        record, plan = self._record, self._plan
        certificate = self._certificate()
        tolerance = plan.constraints.tolerance
        return {
            "format": FORMAT,
            "digest": "",
            "journal": {"events": self._events},
            "mission_id": record.mission_id,
            "name": self._name,
            "tour": self._tour,
            "state": record.state.value,
            "reason": record.reason,
            "vehicle": dict(self._vehicle),
            "camera": camera_to_data(plan.camera),
            "reference": {"kind": record.reference, "yaw_north_deg": _number(record.reference_yaw_north_deg)},
            "position": dict(
                zip(("latitude_deg", "longitude_deg", "altitude_m"), map(_number, record.origin), strict=True)
            ),
            "tolerance_deg": {"pitch": tolerance.pitch_deg, "roll": tolerance.roll_deg, "yaw": tolerance.yaw_deg},
            "times": {
                "started": iso_utc(record.started_utc_s),
                "finished": iso_utc(record.finished_utc_s),
                "written": iso_utc(self._clock.time()),
                "restarts": record.restarts,
            },
            "counts": {
                "shots_total": record.shots_total,
                "shots_done": record.shots_done,
                "attempts": record.attempts,
                "retakes": record.retakes,
                "missing": list(record.missing()),
            },
            "open_loop": record.open_loop,
            "gimbal": _gimbal_json(record),
            "battery": [{"time": iso_utc(time), "charge_frac": round(charge, 4)} for time, charge in self._charges],
            "warnings": list(record.warnings),
            "time_contradictions": [
                {"shot": shot, "attempt": attempt, "photo": photo, "reason": why}
                for (shot, attempt, photo), why in sorted(record.times.contradictions.items())
            ],
            "certificate": _certificate_json(certificate, record),
            "parallax": _parallax_json(self._seams.pairs(record)),
            "conventions": CONVENTIONS,
        }


def _certificate_json(certificate: Certificate | None, record: MissionRecord) -> dict[str, Any] | None:
    """The certificate as flown: of the geometry, in the form of a plan's, and beside it the parts."""
    if certificate is None:
        return None
    return certificate_to_data(certificate) | {
        "geometry": {"certified": certificate.certified},
        "content": _content_json(record),
    }


def _content_json(record: MissionRecord) -> dict[str, Any]:
    content = record.content
    if content is None:
        return {"checked": False, "reason": "no photo reached this computer, or their content was not to be checked"}
    bad = record.bad_photos()
    edges, bridges = content.edges, content.bridges
    return {
        "checked": True,
        "certified": not bad and content.groups <= 1 and not content.unchecked,
        "connected": content.groups == 1 or (content.groups == 0 and not content.unchecked),
        "groups": content.groups,
        "ties": [list(pair) for pair in zip(edges[::2], edges[1::2], strict=True)],
        "bridges": [list(pair) for pair in zip(bridges[::2], bridges[1::2], strict=True)],
        "geometry_only": list(content.geometry_only),
        "geometry_bound_deg": _number(content.geometry_bound_deg),
        "bad": [{"shot": shot, "code": code} for shot, code in bad.items()],
        "unchecked": list(content.unchecked),
        "bridge_shots": [
            {"shot": shot, "between": list(record.shots[shot].between or ()), "ties": list(tied)}
            for shot, tied in record.bridge_ties().items()
        ],
    }


def _parallax_json(pairs: Mapping[tuple[int, int], float]) -> dict[str, Any] | None:
    """The seam errors that the drift is expected to cause; None without positions."""
    if not pairs:
        return None
    (a, b), worst_px = max(pairs.items(), key=lambda item: item[1])
    return {
        "worst_px": round(worst_px, 1),
        "between": [a, b],
        "pairs": [[a, b, round(error_px, 1)] for (a, b), error_px in sorted(pairs.items())],
    }


def read_manifest(path: Path) -> dict[str, Any]:
    """Read a manifest. One without `digest` and `journal`, of an earlier version, is unchecked.

    Raises:
        InputFileError: it cannot be read, is not JSON, is not a manifest of this version, or was changed since.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputFileError(str(path), [f"cannot be read ({error.strerror})"]) from error
    except ValueError as error:
        raise InputFileError(str(path), [f"not JSON ({error})"]) from error
    found = document.get("format") if isinstance(document, dict) else None
    if found != FORMAT:
        raise InputFileError(str(path), [f'format: {found!r} found, "{FORMAT}" expected'])
    if not _is_whole(document):
        raise InputFileError(str(path), ["damaged, or changed since it was written; its digest is that of other data"])
    return document  # type: ignore[no-any-return]


def manifest_events(document: Mapping[str, Any]) -> int | None:
    """Up to which event of the journal a manifest tells; None if an earlier version wrote it."""
    journal = document.get("journal")
    return int(journal["events"]) if isinstance(journal, dict) else None


def _is_whole(document: Mapping[str, Any]) -> bool:
    if "digest" not in document and "journal" not in document:
        return True
    shots = document.get("shots")
    if not isinstance(shots, list):
        return False
    head = {key: value for key, value in document.items() if key != "shots"}
    return document.get("digest") == _digest(head, [seal(json.dumps(shot)) for shot in shots])


def _digest(head: Mapping[str, Any], shots: Sequence[bytes]) -> str:
    """The digest of a manifest, given everything except the shots, and the seal of each shot."""
    return seal(json.dumps({key: value for key, value in head.items() if key != "digest"}), *shots).hex()


def _earlier_charges(path: Path) -> list[tuple[float, float]]:
    """The battery history of an earlier process; empty if it cannot be read."""
    try:
        found = read_manifest(path).get("battery", [])
        return [(datetime.fromisoformat(item["time"]).timestamp(), float(item["charge_frac"])) for item in found]
    except (UsageError, KeyError, TypeError, ValueError, AttributeError):
        return []


def iso_utc(time_utc_s: float) -> str | None:
    """ISO 8601 in UTC with milliseconds; None for NaN."""
    if math.isnan(time_utc_s):
        return None
    return datetime.fromtimestamp(time_utc_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _gimbal_json(record: MissionRecord) -> dict[str, Any] | None:
    """The gimbal that was used and what it was seen to contradict; None before it was acquired."""
    gimbal, contradiction = record.gimbal, record.contradiction
    if gimbal is None:
        return None
    return {
        "manager": gimbal.manager or None,
        "device": gimbal.device or None,
        "device_id": gimbal.device_id or None,
        "feedback": gimbal.feedback or None,
        "north_off_deg": None if contradiction is None else _number(contradiction.north_off_deg),
        "north_corrected": None if contradiction is None else contradiction.corrected,
    }


def _shot_json(record: ShotRecord, reference_yaw_north_deg: float, folder: Path) -> dict[str, Any]:
    shot, accepted = record.shot, record.accepted
    attempts = [_attempt_json(attempt, folder) for attempt in record.attempts]
    return {
        "index": shot.index,
        "row": shot.row,
        "patch": record.patch,
        "bridge": None if record.between is None else list(record.between),
        "status": record.status.value,
        "reason": record.reason,
        "target": _target_json(shot.pitch_deg, shot.yaw_deg)
        | {"yaw_north_deg": _number(to_north(shot.yaw_deg, reference_yaw_north_deg))},
        "accepted_attempt": None if accepted is None else accepted.number,
        "file": "" if accepted is None else attempts[accepted.number - 1]["file"],
        "sha256": None if accepted is None else attempts[accepted.number - 1]["sha256"],
        "content": None if accepted is None else attempts[accepted.number - 1]["content"],
        "refined": None if accepted is None else _refined_json(accepted),
        "attempts": attempts,
    }


def _attempt_json(attempt: AttemptRecord, folder: Path) -> dict[str, Any]:
    exposed = attempt.exposed
    photo = attempt.photos[0] if attempt.photos else None
    photos = [_photo_json(attempt, item, folder) for item in attempt.photos]
    out: dict[str, Any] = {
        "number": attempt.number,
        "round": attempt.round,
        "verdict": attempt.verdict.value,
        "by": attempt.by,
        "code": attempt.code,
        "reason": attempt.reason,
        "seq": attempt.seq,
        "started": iso_utc(attempt.started_utc_s),
        "target": _target_json(attempt.pitch_deg, attempt.yaw_deg),
        "measured": None,
        "error_deg": None,
        "samples": 0,
        "proof": "",
        "evidence": "none" if attempt.evidence is None else attempt.evidence.name.lower(),
        "capture_time": None if photo is None else iso_utc(photo.capture_time_utc_s),
        "file": photos[0]["file"] if photos else "",
        "sha256": photos[0]["sha256"] if photos else None,
        "photos": photos,
        "content": _checked_json(attempt.checked),
    }
    if exposed is not None:
        out["measured"] = None if exposed.measured is None else _pose_json(exposed.measured)
        if exposed.errors is not None:
            out["error_deg"] = {name.removesuffix("_deg"): value for name, value in encode(exposed.errors).items()}
        out["samples"] = exposed.samples
        out["proof"] = exposed.proof
        out["slew_settle_s"] = exposed.slew_settle_s
        out["trigger_delay_s"] = exposed.trigger_delay_s
    return out


def _checked_json(checked: ev.PhotoChecked | None) -> dict[str, Any]:
    """What the content of an attempt's photo proves."""
    if checked is None:
        return {"verdict": "unchecked", "reason": "", "sharpness": None, "ties": []}
    return {
        "verdict": checked.verdict,
        "reason": checked.reason,
        "sharpness": _number(checked.sharpness),
        "odd_deg": checked.odd_deg,
        "error_deg": list(checked.error_deg),
        "ties": [encode(tie) for tie in checked.ties],
    }


def _refined_json(attempt: AttemptRecord) -> dict[str, Any] | None:
    """The attitude that the content implies; None without ties, or if the photo does not count."""
    checked, exposed = attempt.checked, attempt.exposed
    if checked is None or checked.verdict != "ok" or len(checked.error_deg) != 3:
        return None
    if exposed is None or exposed.measured is None:
        return None
    turn = rotation_of_vector(-np.radians(np.array(checked.error_deg)))
    return _pose_json(pose_of(turn @ rotation_from_quaternion(exposed.measured.q_wxyz)))


def _photo_json(attempt: AttemptRecord, photo: ev.Photo, folder: Path) -> dict[str, Any]:
    """A photo: `file` is the stored one, else as told by the camera, which `told` keeps."""
    stored, told = attempt.stored.get(photo.number), file_name(photo.file, folder)
    return encode(photo) | {
        "evidence": attempt.evidence_of(photo).name.lower(),
        "capture_time": iso_utc(photo.capture_time_utc_s),
        "file": told if stored is None else stored.file,
        "told": told,
        "sha256": None if stored is None else stored.sha256,
        "size_bytes": None if stored is None else stored.size_bytes,
        "source": None if stored is None else stored.source,
        "raw": (stored.raw or None) if stored is not None else None,
        "exif": None if stored is None or stored.exif is None else encode(stored.exif),
        "differs": None if stored is None else list(stored.differs),
        "taken": None if stored is None else iso_utc(stored.taken_s),
    }


def file_name(reported: str, folder: Path) -> str:
    """A file name or URL reported by the camera, relative to the mission's directory if the file is in it."""
    parts = urlsplit(reported)
    if parts.scheme == "file" and parts.netloc in {"", "localhost"}:
        path = Path(unquote(parts.path))
        if path.is_relative_to(folder.resolve()):
            return path.relative_to(folder.resolve()).as_posix()
    return reported


@functools.lru_cache(maxsize=1024)
def _target_json(pitch_deg: float, yaw_deg: float) -> dict[str, Any]:
    """A target as JSON; cached, so callers must not modify it."""
    return _pose_json(pose_of(rotation(yaw_deg, pitch_deg)))


def _pose_json(pose: ev.MeasuredPose) -> dict[str, Any]:
    return {
        "quaternion": list(pose.q_wxyz),
        "roll_deg": pose.roll_deg,
        "pitch_deg": pose.pitch_deg,
        "yaw_deg": pose.yaw_deg,
    }


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value
