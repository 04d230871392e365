"""The page of a tour is written for what is there, and says what is not."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from panoexec.cli.app import run
from panoexec.report.tour import write_tour_report
from panoexec.store.tours import Stop, Tour, tours_folder, write_tour

TOUR_ID = "tour-20260921T141200.000Z"


def written(storage: Path, *stops: Stop) -> Path:
    write_tour(storage, Tour(tour_id=TOUR_ID, vehicle="drone", digest="ab", waypoints=(2,), stops=stops))
    return tours_folder(storage) / f"{TOUR_ID}.json"


def stop(**fields: object) -> Stop:
    given = {"number": 1, "waypoint": 2, "preset": "roof", "latitude_deg": 47.4, "longitude_deg": 8.5} | fields
    return Stop(**given)  # type: ignore[arg-type]


def test_a_mission_that_is_gone_is_told(tmp_path: Path) -> None:
    report = write_tour_report(written(tmp_path, stop(mission_id="20260921T141300.000Z", outcome="complete")))
    assert (report.stops, report.complete, report.panoramas) == (1, 1, 0)
    assert len(report.notes) == 1
    assert report.notes[0].startswith("stop 1: ")
    assert report.path.read_text().count('"its mission cannot be read"') == 1


def test_a_tour_without_stops_has_a_page(tmp_path: Path) -> None:
    assert write_tour_report(written(tmp_path)).path.is_file()


def test_a_station_that_was_passed_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, stop(number=1, waypoint=4, outcome="complete"))
    assert write_tour_report(path).missed == (2,)
    assert run(["report", TOUR_ID, "--storage", str(tmp_path)]) == 1
    assert "no stop at waypoints 2" in capsys.readouterr().err


@pytest.mark.parametrize(("outcome", "code"), [("complete", 0), ("skipped", 1)])
def test_the_command_finds_it_by_its_name(
    tmp_path: Path, outcome: str, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    written(tmp_path, stop(outcome=outcome))
    assert run(["report", TOUR_ID, "--storage", str(tmp_path), "--json"]) == code
    document = json.loads(capsys.readouterr().out)
    assert document["stops"] == 1
    assert Path(document["report"]).name == f"{TOUR_ID}.html"


def test_a_damaged_tour_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written(tmp_path, stop()).write_text("{")
    assert run(["report", TOUR_ID, "--storage", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_photos_are_embedded_for_one_mission_only(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, stop())
    assert run(["report", str(path), "--embed", str(tmp_path / "out")]) == 2
    assert "--embed" in capsys.readouterr().err
