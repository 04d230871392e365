"""The manifest, derived anew from the journal where it is missing, damaged or older."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from panoexec.clock import SystemClock
from panoexec.codec import decode
from panoexec.errors import InputFileError, MissionError, UsageError
from panoexec.files import write_atomically
from panoexec.inputs.plan_file import plan_from_data
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.measured_certificate import certify_measured
from panoexec.mission.tour_stop import stop_in
from panoexec.planning.model import Certificate, Plan
from panoexec.store.catalogue import glance
from panoexec.store.directory import MissionDirectory
from panoexec.store.journal import JournalFileError, load_journal
from panoexec.store.journal_layout import JournalContents
from panoexec.store.manifest import ManifestWriter, manifest_events, read_manifest

VEHICLE = "vehicle"
"""Extra data in the journal's head: the manifest's data on the vehicle."""
NAME = "name"
"""Extra data in the journal's head: what people call the mission."""


class LostEventsError(UsageError):
    """The manifest tells of events that the journal does not have: the journal lost its end."""


def current_manifest(directory: MissionDirectory) -> dict[str, Any]:
    """The manifest as of the last event of the journal; blocks, and writes nothing.

    It is read from its file unless that is missing, damaged or older than the journal. A journal that is missing, in
    use or cannot be read has no say.

    Raises:
        InputFileError: the file cannot be used, and neither can the journal.
    """
    text = rebuilt_manifest(directory)
    if text is None:
        return read_manifest(directory.manifest)
    document: dict[str, Any] = json.loads(text)
    return document


def restore_manifest(directory: MissionDirectory) -> bool:
    """Write the manifest anew if it is missing, damaged or older than the journal; blocks.

    Returns:
        Whether it was written.

    Raises:
        LostEventsError: it is newer than the journal; it stays as it is.
        JournalFileError: the journal cannot be read.
        UsageError: the manifest cannot be written.
    """
    seen = glance(directory.journal)
    try:
        told = manifest_events(read_manifest(directory.manifest))
    except InputFileError:
        told = None
    if told is not None and told > seen.events:
        raise LostEventsError(
            f"{directory.journal}: ends with event {seen.events}, but {directory.manifest.name} tells of event {told}:"
            " the journal lost its end"
        )
    text = rebuilt_manifest(directory)
    if text is None:
        return False
    write_atomically(directory.manifest, text)
    return True


def rebuilt_manifest(directory: MissionDirectory) -> str | None:
    """The manifest derived from the journal; None if the file is current, or the journal cannot be read."""
    try:
        seen = glance(directory.journal)
        try:
            document = read_manifest(directory.manifest)
        except InputFileError:
            pass
        else:
            told = manifest_events(document)
            # an earlier version did not say up to which event; a state that it had not reached yet is older
            if document.get("state") == seen.state.value if told is None else told >= seen.events:
                return None
        return derived_manifest(directory, load_journal(directory.journal))
    except JournalFileError:
        return None


def derived_manifest(directory: MissionDirectory, contents: JournalContents) -> str:
    """The manifest of a journal; the battery's history, of which no event tells, is taken over if it can be read.

    Raises:
        JournalFileError: the plan or an event makes no sense.
    """
    try:
        plan_data = json.loads(contents.head["plan"])
        plan = plan_from_data(plan_data, source=f"{directory.journal} (plan)").plan()
        record = MissionRecord.from_events(
            mission_id=directory.mission_id, shots=plan.shots, events=list(contents.events)
        )
        extra = json.loads(contents.head.get("extra", "{}"))
    except (ValueError, LookupError, MissionError, UsageError) as error:
        raise JournalFileError(f"{directory.journal}: no manifest can be made of it ({error})") from error
    certificate = _certificate(plan, plan_data, record, contents)
    writer = ManifestWriter(
        path=directory.manifest,
        plan=plan,
        record=record,
        vehicle=_vehicle(directory, extra),
        name=mission_name(extra),
        tour=stop_in(extra),
        clock=SystemClock(),
        certificate=lambda: certificate,
    )
    return writer.text()


def mission_name(extra: Mapping[str, Any]) -> str:
    """What people call a mission; "" without a name."""
    name = extra.get(NAME)
    return name if isinstance(name, str) else ""


def _vehicle(directory: MissionDirectory, extra: Mapping[str, Any]) -> Mapping[str, Any]:
    """The data on the vehicle: as last told, else as of the start."""
    try:
        told = read_manifest(directory.manifest).get("vehicle")
    except UsageError:
        told = None
    found = told or extra.get(VEHICLE)
    return found if isinstance(found, dict) else {}


def _certificate(
    plan: Plan, plan_data: Mapping[str, Any], record: MissionRecord, contents: JournalContents
) -> Certificate | None:
    """The certificate of the panorama as flown, with the verdict that the mission ended with; else None."""
    last = next((event for event in reversed(contents.events) if isinstance(event, ev.MissionFinished)), None)
    rotations, rows = record.measured()
    if last is None or last.certified is None or not record.ended or not rows:
        return None
    planned = None
    if plan_data.get("certificate") is not None:
        planned = decode(Certificate, plan_data["certificate"])
    # a resumed mission was certified without the certificate of its plan
    for candidate in (replace(plan, certificate=planned), plan):
        found = certify_measured(candidate, rotations, rows)
        if found.certified == last.certified:
            return found
    return None
