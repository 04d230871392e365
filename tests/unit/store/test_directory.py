"""Mission directories."""

from __future__ import annotations

from pathlib import Path

import pytest

from panoexec.errors import UsageError
from panoexec.store.directory import existing_mission_directory, mission_directories, new_mission_directory


def test_names_sort_by_time_and_never_collide(tmp_path: Path) -> None:
    times = [1_700_000_000.0, 1_700_000_000.0, 1_700_000_000.001, 1_700_000_001.5, 1_800_000_000.0]
    made = [new_mission_directory(tmp_path, now_utc_s=time) for time in times]
    names = [directory.mission_id for directory in made]
    assert names == sorted(names)
    assert len(set(names)) == len(names)
    assert names[0] == "20231114T221320.000Z"
    (tmp_path / "missions" / "lost+found").mkdir()
    assert mission_directories(tmp_path) == made
    assert mission_directories(tmp_path / "nothing") == []


def test_a_storage_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="file/missions: cannot be created"):
        new_mission_directory(tmp_path / "file", now_utc_s=0.0)


def test_what_holds_no_mission_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such directory"):
        existing_mission_directory(tmp_path / "nothing")
    with pytest.raises(UsageError, match="not a mission directory"):
        existing_mission_directory(tmp_path)
    (tmp_path / "journal.sqlite").touch()
    assert existing_mission_directory(tmp_path).journal == tmp_path / "journal.sqlite"
