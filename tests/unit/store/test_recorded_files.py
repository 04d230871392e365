"""Files of a mission that an earlier version wrote (`tests/data/recorded`): what was stored must stay readable."""

from __future__ import annotations

import json
import math
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote, urlsplit

import pytest

from panoexec.clock import SystemClock
from panoexec.codec import decode, encode
from panoexec.exports import export_set, write_exports
from panoexec.inputs.plan_file import camera_to_data, certificate_to_data, plan_to_data, read_plan_file, write_plan
from panoexec.mission.log.events import Event
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.measured_certificate import certify_measured
from panoexec.mission.settings import MissionSettings
from panoexec.optics import Camera
from panoexec.planning.certificate.verdict import certify
from panoexec.planning.make_plan import finished
from panoexec.planning.model import Certificate, Estimate, Plan, Timing
from panoexec.report.source import read_source
from panoexec.sim import settings as sim_settings
from panoexec.store.directory import MissionDirectory
from panoexec.store.journal import read_journal
from panoexec.store.manifest import ManifestWriter, read_manifest
from panoexec.store.session import NotResumableError, open_mission
from tests.repository import ROOT

RECORDED: Final = ROOT / "tests" / "data" / "recorded"
EVENTS: Final = 95


@pytest.fixture
def mission(tmp_path: Path) -> MissionDirectory:
    """A copy: a reader of SQLite may leave files beside the journal."""
    manifest = json.loads((RECORDED / "manifest.json").read_text())
    shutil.copytree(RECORDED, tmp_path / manifest["mission_id"])
    return MissionDirectory(tmp_path / manifest["mission_id"])


def stored(mission: MissionDirectory) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Head and events of the journal as they stand in it."""
    with closing(sqlite3.connect(mission.journal)) as connection:
        head = dict(connection.execute("SELECT key, value FROM head"))
        return head, [json.loads(text) for (text,) in connection.execute("SELECT json FROM events ORDER BY seq")]


def alike(a: Any, b: Any) -> bool:
    """The same document but for what another processor rounds in another way."""
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(alike(a[key], b[key]) for key in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(alike, a, b))
    if isinstance(a, float) and isinstance(b, float):
        return math.isclose(a, b, rel_tol=1e-12, abs_tol=1e-12)
    return bool(a == b)


def replayed(mission: MissionDirectory) -> tuple[Plan, list[Event], MissionRecord]:
    plan = read_plan_file(mission.plan).plan()
    _, events = read_journal(mission.journal)
    return plan, events, MissionRecord.from_events(mission_id=mission.mission_id, shots=plan.shots, events=events)


def test_every_event_is_read_and_written_again_as_it_stands(mission: MissionDirectory) -> None:
    _, documents = stored(mission)
    _, events = read_journal(mission.journal)
    assert len(events) == EVENTS
    assert len(documents) == EVENTS
    assert all(map(same_where_recorded, documents, [event.to_json() for event in events]))
    assert len({event.type for event in events}) > 6


def test_the_journal_leads_to_the_counts_of_the_manifest(mission: MissionDirectory) -> None:
    manifest = read_manifest(mission.manifest)
    _, _, record = replayed(mission)
    assert record.state.value == manifest["state"] == "complete"
    counts = {
        "shots_total": record.shots_total,
        "shots_done": record.shots_done,
        "attempts": record.attempts,
        "retakes": record.retakes,
        "missing": list(record.missing()),
    }
    assert counts == manifest["counts"]


def same_where_recorded(recorded: object, again: object) -> bool:
    """Whether every recorded value is there again; what was added since has its default."""
    if isinstance(recorded, dict):
        return isinstance(again, dict) and all(
            name in again and same_where_recorded(value, again[name]) for name, value in recorded.items()
        )
    return recorded == again


def as_recorded(camera: Camera) -> dict[str, object]:
    """The camera as that version wrote it, which knew the nominal lens alone."""
    data = camera_to_data(camera.with_lens("nominal"))
    assert data.pop("lens") == "nominal"
    return data


def test_the_settings_and_the_simulation_in_the_journal_are_read(mission: MissionDirectory) -> None:
    head, _ = stored(mission)
    document = json.loads(head["settings"])
    settings = decode(MissionSettings, document)
    assert same_where_recorded(document, encode(settings))
    assert settings.min_evidence.name.lower() == document["min_evidence"]
    simulation = json.loads(head["extra"])["simulation"]
    assert same_where_recorded(simulation, sim_settings.to_json(sim_settings.from_json(simulation)))


async def test_a_mission_that_is_over_is_still_recognised_as_such(mission: MissionDirectory) -> None:
    with pytest.raises(NotResumableError, match="complete"):
        await open_mission(mission)


def test_the_readers_of_the_manifest_take_it(mission: MissionDirectory) -> None:
    source = read_source(mission)
    assert source.notes == ()
    assert len(source.events) == EVENTS
    assert source.simulated
    assert source.settings is not None
    assert source.plan is not None
    assert len(source.photos) == 18
    assert {photo.problem for photo in source.photos.values()} == {"is missing"}


def test_the_manifest_is_exported(mission: MissionDirectory) -> None:
    document = read_manifest(mission.manifest)
    exports = export_set(document, mission.path)
    assert len(exports.shots) == document["counts"]["shots_done"]
    assert as_recorded(exports.camera) == document["camera"]
    written = {path.name for path in write_exports(exports, mission.path)}
    assert {"panorama.pto", "shots.csv"} <= written
    images = [line for line in (mission.path / "panorama.pto").read_text().splitlines() if line.startswith("i ")]
    assert len(images) == 18
    assert all(f"IMG_{number:05}.jpg" in "".join(images) for number in (1, 25))


def test_the_manifest_can_be_written_anew_from_plan_and_journal(mission: MissionDirectory) -> None:
    recorded = read_manifest(mission.manifest)
    head, documents = stored(mission)
    plan, _, record = replayed(mission)
    plan = replace(plan, camera=plan.camera.with_lens("nominal"))
    certificate = decode(Certificate, json.loads(head["plan"])["certificate"])
    # names of photos are relative to where the mission was flown
    told = next(photo["file"] for document in documents for photo in document.get("photos", []) if photo["file"])
    flown_in = Path(unquote(urlsplit(told).path)).parent.parent
    rotations, rows = record.measured()
    writer = ManifestWriter(
        path=flown_in / mission.manifest.name,
        plan=plan,
        record=record,
        vehicle=recorded["vehicle"],
        clock=SystemClock(),
        certificate=lambda: certify_measured(replace(plan, certificate=certificate), rotations, rows),
    )
    written = json.loads(writer.text())
    assert written.pop("journal") == {"events": EVENTS}
    assert len(written.pop("digest")) == 32
    assert written.pop("gimbal")["manager"] is None, "no event of that version names it"
    assert written.pop("name") == ""
    assert written.pop("tour") is None
    assert written["camera"].pop("lens") == "nominal"
    assert written.pop("parallax") is None
    assert written.pop("time_contradictions") == []
    for shot in written["shots"]:
        assert shot.pop("bridge") is None
        for where in (shot, *shot["attempts"]):
            assert where.pop("sha256") is None
        for photo in (photo for attempt in shot["attempts"] for photo in attempt["photos"]):
            assert photo.pop("told") == photo["file"]
            later = ("sha256", "size_bytes", "source", "raw", "exif", "differs", "taken")
            assert [photo.pop(name) for name in later] == [None] * 7
    written["certificate"].pop("geometry")
    assert written["certificate"].pop("content")["checked"] is False
    for shot in written["shots"]:
        for part in (shot, *shot["attempts"]):
            assert part.pop("content")["verdict"] == "unchecked"
        assert shot.pop("refined") is None
    assert {attempt.pop("proof") for shot in written["shots"] for attempt in shot["attempts"]} == {""}
    orders = [attempt.pop("seq") for shot in written["shots"] for attempt in shot["attempts"]]
    assert min(orders) > 0
    assert len(set(orders)) == len(orders)
    for document in (recorded, written):
        document["times"].pop("written")
        document.pop("battery")  # it is in no event
    assert alike(written, recorded)


def test_the_plan_file_is_written_again_as_it_stands(mission: MissionDirectory, tmp_path: Path) -> None:
    document = json.loads(mission.plan.read_text())
    plan = read_plan_file(mission.plan).plan()
    assert plan.camera.lens_used == "calibrated", "where the file does not say, the lens in the air counts"
    plan = replace(plan, camera=plan.camera.with_lens("nominal"))
    whole = finished(plan, Timing(), order=None)
    assert whole.certificate == certify(plan)
    assert alike(certificate_to_data(certify(plan)), document["certificate"])
    again = replace(
        whole,
        certificate=decode(Certificate, document["certificate"]),
        estimate=decode(Estimate, document["estimate"] | {"band_px": document["estimate"]["panorama_px"]}),
        lower_bound=document["lower_bound"],
        notes=tuple(document["notes"]),
    )
    write_plan(tmp_path / "again.json", again)
    assert same_where_recorded(document, json.loads((tmp_path / "again.json").read_text()))
    head, _ = stored(mission)
    assert json.loads(head["plan"]) == document
    assert same_where_recorded(document, json.loads(json.dumps(plan_to_data(again))))
