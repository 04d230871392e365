"""Tours on disk: whole or refused, found by id and path."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from panoexec.errors import InputFileError, UsageError
from panoexec.store.tours import Stop, Tour, find_tour, new_tour_id, newest_tour, read_tour, tours_folder, write_tour

STOP = Stop(
    number=1, waypoint=4, preset="roof", latitude_deg=47.4, longitude_deg=8.5, arrived="2026-11-30T18:17:39.552Z"
)
NOW_S = 1_800_000_000.0


def tour(storage: Path, **changes: Any) -> Tour:
    made = Tour(
        tour_id=new_tour_id(storage, now_utc_s=NOW_S), vehicle="drone", digest="ab", waypoints=(4, 6), stops=(STOP,)
    )
    return replace(made, **changes)


def test_what_is_written_is_read(tmp_path: Path) -> None:
    written = tour(tmp_path)
    write_tour(tmp_path, written)
    assert newest_tour(tmp_path) == written
    assert written.open_stop == STOP
    closed = written.with_stop(replace(STOP, outcome="complete"))
    assert (closed.open_stop, closed.visits(4), closed.visits(6)) == (None, 1, 0)


def test_ids_are_free_ones(tmp_path: Path) -> None:
    first = tour(tmp_path)
    write_tour(tmp_path, first)
    second = tour(tmp_path)
    assert second.tour_id > first.tour_id
    write_tour(tmp_path, second)
    assert newest_tour(tmp_path) == second


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text[: len(text) // 2],
        lambda text: "[]",
        lambda text: text.replace("panoexec.tour/1", "panoexec.tour/2"),
        lambda text: text.replace('"waypoint": 4', '"waypoint": "four"'),
        lambda text: text.replace('"latitude_deg": 47.4', '"latitude_deg": null'),
        lambda text: text.replace('"mission_id": null', '"mission_id": "../../etc"'),
        lambda text: text.replace('"tour_id": "tour-', '"tour_id": "../tour-'),
        lambda text: re.sub(r'("waypoints": \[\s*)\d+', r"\g<1>1e999", text),
        lambda text: "[" * 100_000,
    ],
)
def test_a_damaged_one_is_refused_by_name_and_passed_over(tmp_path: Path, damage: Any) -> None:
    write_tour(tmp_path, tour(tmp_path))
    (path,) = tours_folder(tmp_path).glob("*.json")
    damaged = damage(path.read_text())
    assert damaged != path.read_text()
    path.write_text(damaged)
    with pytest.raises(InputFileError, match=path.name):
        read_tour(path)
    assert newest_tour(tmp_path) is None


def test_a_later_version_may_say_more(tmp_path: Path) -> None:
    write_tour(tmp_path, tour(tmp_path))
    (path,) = tours_folder(tmp_path).glob("*.json")
    document = json.loads(path.read_text())
    document["weather"] = "fair"
    document["stops"][0]["clouds"] = 3
    path.write_text(json.dumps(document))
    assert read_tour(path).stops == (STOP,)


def test_it_is_found_by_id_and_by_path(tmp_path: Path) -> None:
    made = tour(tmp_path)
    write_tour(tmp_path, made)
    path = tours_folder(tmp_path) / f"{made.tour_id}.json"
    assert find_tour(made.tour_id, [tmp_path]) == path
    assert find_tour(str(path), []) == path
    assert find_tour(str(tours_folder(tmp_path) / made.tour_id), []) == path
    assert find_tour("20261130T181739.594Z", [tmp_path]) is None
    assert find_tour(str(tmp_path), [tmp_path]) is None


def test_a_storage_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "tours").write_text("")
    with pytest.raises(UsageError, match="tours"):
        write_tour(tmp_path, tour(tmp_path))
