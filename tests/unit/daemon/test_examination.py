"""The daemon's examination: one at a time, and out of the way of missions."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any, cast

import pytest

from panoexec.adapters.linked_vehicle import LinkedVehicle
from panoexec.clock import SystemClock
from panoexec.daemon import examination
from panoexec.daemon.beginnings import Beginning
from panoexec.daemon.errors import MissionBusyError
from panoexec.daemon.examination import Examination
from panoexec.daemon.missions import Missions
from panoexec.daemon.vehicle_link import VehicleLink
from panoexec.doctor.findings import Findings
from panoexec.inputs.config import Config


class Sink:
    def publish(self, _event: object) -> None: ...


class Checks:
    """In place of the doctor's checks: begin, and end when told."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.begun, self.end = asyncio.Event(), asyncio.Event()
        self.asked: list[dict[str, Any]] = []
        self.given_back = False
        monkeypatch.setattr(examination, "examine_vehicle", self.vehicle)
        monkeypatch.setattr(examination, "check_surroundings", self.surroundings)

    async def vehicle(self, _linked: object, _config: Config, findings: Findings, **how: Any) -> None:
        self.asked.append(how)
        self.begun.set()
        try:
            await self.end.wait()
        finally:
            await asyncio.sleep(0)  # the gimbal is released
            self.given_back = True
        findings.ok("link", "port", "looked at")

    async def surroundings(self, _config: Config, _file: Path, findings: Findings) -> None:
        findings.ok("disk", "room", "plenty")


class Connected(VehicleLink):
    """A link that is open."""

    linked = cast("LinkedVehicle", object())
    lacking = ""


class Daemon:
    """What an examination needs of one."""

    def __init__(self, folder: Path, *, connected: bool = True) -> None:
        config = Config.model_validate({"storage": {"path": folder}})
        self.missions = Missions(config=lambda: config, clock=SystemClock(), sink=Sink(), changed=lambda: None)
        vehicle = (Connected if connected else VehicleLink)(lambda: config, clock=SystemClock())
        self.examination = Examination(
            config=lambda: config, config_file=folder / "c.toml", missions=self.missions, vehicle=vehicle
        )


async def test_the_findings_are_the_daemons(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checks, daemon = Checks(monkeypatch), Daemon(tmp_path)
    checks.end.set()
    document = await daemon.examination.run(photo=True)
    assert document["examined_by"] == "daemon"
    assert [f["check"] for f in document["findings"]] == ["port", "examined by", "room"]
    assert (checks.asked[0]["photo"], checks.asked[0]["in_use"]) == (True, False)


async def test_a_mission_that_begins_ends_it_and_waits_until_the_devices_are_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checks, daemon = Checks(monkeypatch), Daemon(tmp_path)
    running = asyncio.create_task(daemon.examination.run(photo=False))
    await checks.begun.wait()
    with pytest.raises(MissionBusyError, match="is being examined already"):
        await daemon.examination.run(photo=False)
    async with daemon.missions.claimed(Beginning("start")):
        assert checks.given_back
        with pytest.raises(MissionBusyError, match="a mission began, which ended the examination"):
            await running
        checks.end.set()
        document = await daemon.examination.run(photo=True)
        assert checks.asked[-1]["in_use"]
        told = next(f["found"] for f in document["findings"] if f["check"] == "examined by")
        assert "while a mission is under way" in told


async def test_whoever_waits_for_it_may_give_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checks, daemon = Checks(monkeypatch), Daemon(tmp_path)
    running = asyncio.create_task(daemon.examination.run(photo=False))
    await checks.begun.wait()
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running
    checks.end.set()
    assert (await daemon.examination.run(photo=False))["examined_by"] == "daemon"


async def test_without_a_link_the_rest_is_examined(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checks, daemon = Checks(monkeypatch), Daemon(tmp_path, connected=False)
    document = await daemon.examination.run(photo=False)
    assert checks.asked == []
    port = document["findings"][0]
    assert (port["check"], port["verdict"], port["found"]) == ("port", "missing", "not connected yet")
    assert not document["healthy"]
    assert document["findings"][-1]["check"] == "room"


def test_the_document_is_read_back_as_it_was() -> None:
    findings = Findings()
    findings.autopilot, findings.examined_by = "px4", "daemon"
    findings.missing("gimbal", "found", "none", needed="one", advice="MNT_MODE_OUT = 2")
    findings.ok("link", "port", "there")
    again = Findings.from_document(findings.document())
    assert again.document() == findings.document()
    assert again.exit_code == 3
    with pytest.raises(ValueError, match="unknown area 'kitchen'"):
        Findings.from_document(findings.document() | {"findings": [{"area": "kitchen"}]})
