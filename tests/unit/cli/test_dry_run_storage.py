"""Where a dry-run may write is looked at before any work."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from panoexec.cli.dry_run import _check_storage
from panoexec.errors import UsageError


def test_several_look_at_one_folder_at_once_and_leave_nothing(tmp_path: Path) -> None:
    with ThreadPoolExecutor(8) as pool:
        for _ in pool.map(_check_storage, [tmp_path / "out"] * 400):
            pass
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"proc: cannot be written \("):
        _check_storage(Path("/proc"))
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="file is not a folder"):
        _check_storage(tmp_path / "file" / "out")
