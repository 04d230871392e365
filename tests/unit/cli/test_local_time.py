"""The clock of who reads stands beside UTC where they differ."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from panoexec.cli.app import run
from panoexec.cli.operate import VERBS
from panoexec.cli.output import local_time
from panoexec.cli.watch_view import Watched, mission_view
from tests.unit.cli.test_cli_watch_view import STATE, shown

ID = "20261122T233000.500Z"


@pytest.fixture
def zone(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("TZ", request.param)
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


here = pytest.mark.parametrize("zone", ["CET-1"], indirect=True)
in_utc = pytest.mark.parametrize("zone", ["UTC0"], indirect=True)


@here
@pytest.mark.usefixtures("zone")
def test_the_beginning_of_a_mission_in_local_time() -> None:
    assert local_time(ID) == "00:30"
    assert local_time(ID, "%Y-%m-%d %H:%M") == "2026-11-23 00:30"


@pytest.mark.parametrize("mission_id", ["", "x", "2026", "00000000T000000.000Z", "99991231T235959.999Z", "\x00"])
@here
@pytest.mark.usefixtures("zone")
def test_what_is_no_time_is_none(mission_id: str) -> None:
    assert local_time(mission_id) == ""


@in_utc
@pytest.mark.usefixtures("zone")
def test_nothing_is_said_where_the_clock_is_utc() -> None:
    assert local_time(ID) == ""
    assert "local time" not in status()
    assert "local time" not in watched()


@here
@pytest.mark.usefixtures("zone")
def test_watch_and_status_say_it() -> None:
    assert f"mission {ID} (began 00:30 local time): 3 of 5 shots done" in status()
    assert "began 00:30 local time" in watched()


@here
@pytest.mark.usefixtures("zone")
def test_missions_are_listed_with_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "missions" / ID
    folder.mkdir(parents=True)
    (folder / "manifest.json").write_text("{")
    (folder / "journal.sqlite").write_bytes(b"x")
    assert run(["missions", "--storage", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "local time" in out
    assert "2026-11-23 00:30" in out


def status() -> str:
    data = {"state": "capturing", "mission_id": ID, "shots_done": 3, "shots_total": 5, "link": {}}
    return VERBS["status"].sentence(data, "kite")


def watched() -> str:
    one = Watched()
    one.hear("state", STATE | {"mission_id": ID})
    return shown(mission_view("kite", one))
