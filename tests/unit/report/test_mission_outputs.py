"""What a mission leaves behind: all that can be written, and one message of what cannot."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from panoexec.errors import InputFileError, UsageError
from panoexec.report import mission_outputs
from panoexec.report.mission_outputs import write_mission_outputs
from panoexec.store.directory import MissionDirectory, mission_directories
from panoexec.store.session import Devices, MissionSession, create_mission
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import a_world


@pytest.fixture(name="directory")
def a_mission(tmp_path: Path) -> MissionDirectory:
    """Of a complete mission, without its output files."""

    async def fly() -> None:
        async with a_world() as world:
            devices = Devices(gimbal=world.gimbal, camera=world.camera, vehicle=world.vehicle)
            stored = await create_mission(
                tmp_path, plan=world.plan, settings=world.settings, now_utc_s=world.clock.time()
            )
            opened = MissionSession.opened(
                stored, devices=devices, clock=world.clock, sink=world.sink, vehicle={"id": "v1"}
            )
            async with opened as session:
                await session.run()

    run_virtual(fly())
    return mission_directories(tmp_path)[0]


def test_leaves_what_stitchers_work_from(directory: MissionDirectory) -> None:
    write_mission_outputs(directory)
    assert {"panorama.pto", "papywizard.xml", "shots.csv"} <= {path.name for path in directory.path.iterdir()}


def test_one_that_fails_does_not_keep_the_others_from_being_written(
    directory: MissionDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_: MissionDirectory) -> None:
        raise UsageError("no ink")

    monkeypatch.setattr(
        mission_outputs, "MISSION_OUTPUTS", {"first": broken} | dict(mission_outputs.MISSION_OUTPUTS) | {"last": broken}
    )
    with pytest.raises(UsageError, match=r"^first: no ink; last: no ink$"):
        write_mission_outputs(directory)
    assert (directory.path / "panorama.pto").exists()


def test_names_a_manifest_that_is_damaged(directory: MissionDirectory) -> None:
    directory.manifest.write_text("{", encoding="utf-8")
    with pytest.raises(InputFileError, match=r"manifest\.json"):
        write_mission_outputs(directory)


def test_the_page_for_people_is_among_them(directory: MissionDirectory) -> None:
    """Of a flown mission, with the journal's times and the battery's history."""
    write_mission_outputs(directory)
    page = directory.report.read_text(encoding="utf-8")
    data = json.loads(page.split('id="data">')[1].split("</script>")[0])
    assert data["notes"] == []
    assert data["timeline"]["measured"]
    assert 0 < data["timeline"]["limit_s"] <= data["timeline"]["duration_s"] + 0.01
    assert data["battery"]["samples"][0][0] == 0
