from __future__ import annotations

import stat
from pathlib import Path

import pytest

from panoexec.errors import UsageError
from panoexec.files import write_atomically, write_atomically_with


def test_writes_text_and_bytes_and_replaces(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_atomically(path, "grün")
    assert path.read_text(encoding="utf-8") == "grün"
    write_atomically(path, b"\x00\xff", sync=False)
    assert path.read_bytes() == b"\x00\xff"
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]
    assert stat.S_IMODE(path.stat().st_mode) & 0o400


def test_a_missing_folder_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no-such/x\.json: cannot be written \(No such file or directory\)"):
        write_atomically(tmp_path / "no-such" / "x.json", "")


def test_a_failing_writer_leaves_the_old_file_and_no_litter(tmp_path: Path) -> None:
    path = tmp_path / "plot.png"
    write_atomically(path, "old")

    def write(temporary: Path) -> None:
        assert temporary.suffix == ".png"
        temporary.write_text("half")
        raise ValueError

    with pytest.raises(ValueError):
        write_atomically_with(path, write)
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["plot.png"]


def test_a_disk_that_is_full_is_a_usage_error(tmp_path: Path) -> None:
    def write(_: Path) -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(UsageError, match="No space left on device"):
        write_atomically_with(tmp_path / "x", write)
    assert not list(tmp_path.iterdir())
