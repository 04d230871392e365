"""Missions ended by an internal error, such as a full disk: the mission cannot announce its end itself."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from panoexec.clock import SystemClock
from panoexec.daemon.missions import Missions
from panoexec.devices import Severity
from panoexec.errors import DeviceError
from panoexec.inputs.config import Config
from panoexec.mission.log.events import Event
from panoexec.store.journal import JournalFileError


class Sink:
    def publish(self, event: Event) -> None:
        raise AssertionError(event)


class Vehicle:
    def __init__(self, *, deaf: bool = False) -> None:
        self.said: list[tuple[str, Severity]] = []
        self._deaf = deaf

    async def say(self, text: str, severity: Severity = Severity.NOTICE) -> None:
        if self._deaf:
            raise DeviceError("no link")
        self.said.append((text, severity))


@pytest.mark.parametrize("deaf", [False, True])
async def test_pilot_and_ground_station_learn_why(monkeypatch: pytest.MonkeyPatch, deaf: bool) -> None:
    async def fails(*_: object) -> None:
        raise JournalFileError("journal.sqlite: the journal cannot be written (disk is full)")

    missions = Missions(config=Config, clock=SystemClock(), sink=Sink(), changed=lambda: None)
    monkeypatch.setattr(missions, "_fly", fails)
    vehicle = Vehicle(deaf=deaf)
    stored: Any = SimpleNamespace(directory=SimpleNamespace(mission_id="m", path=Path("m")))
    devices: Any = SimpleNamespace(vehicle=vehicle)
    await missions._flown(stored, devices, "north")
    assert missions.trouble == "journal.sqlite: the journal cannot be written (disk is full)"
    assert vehicle.said == ([] if deaf else [(f"Pano: ended by an error: {missions.trouble}", Severity.ERROR)])
