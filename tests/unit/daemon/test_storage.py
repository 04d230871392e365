"""What a crew is told of a storage before the flight."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path
from types import SimpleNamespace

import pytest
from structlog.testing import capture_logs

from panoexec.daemon.storage import StorageMonitor, storage_trouble
from panoexec.inputs.service_sections import StorageSection
from panoexec.mqtt.transactions import Transactions
from tests.waiting import eventually


@pytest.mark.parametrize(
    ("found", "says"),
    [
        ({"f_flag": 0, "f_bavail": 300_000, "f_frsize": 1000}, ""),
        ({"f_flag": 0, "f_bavail": 199_000, "f_frsize": 1000}, "has 199 MB left: [storage] min_free_mb requires 200"),
        ({"f_flag": os.ST_RDONLY, "f_bavail": 300_000, "f_frsize": 1000}, "is read-only"),
    ],
)
def test_a_disk(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, found: dict[str, int], says: str) -> None:
    monkeypatch.setattr(os, "statvfs", lambda _: SimpleNamespace(**found))
    trouble = storage_trouble(StorageSection(path=tmp_path, min_free_mb=200))
    assert says in trouble
    assert bool(trouble) is bool(says)


def test_a_folder_that_is_not_there_yet_or_is_none(tmp_path: Path) -> None:
    assert storage_trouble(StorageSection(path=tmp_path / "later")) == ""
    (tmp_path / "file").write_text("")
    assert "cannot be used" in storage_trouble(StorageSection(path=tmp_path / "file" / "below"))


async def test_trouble_and_recovery_are_logged_and_the_storage_is_announced_as_readable_once(tmp_path: Path) -> None:
    section = StorageSection(path=tmp_path, min_free_mb=1e12)
    changes, readable, recovered = [], [], []

    async def on_readable() -> None:
        readable.append(monitor.trouble)

    async def on_recovered() -> None:
        recovered.append(monitor.trouble)

    transactions = await Transactions.open(tmp_path / "transactions.sqlite", boot_id="boot")
    monitor = StorageMonitor(
        section=lambda: section,
        transactions=transactions,
        changed=lambda: changes.append(monitor.trouble),
        on_readable=on_readable,
        on_recovered=on_recovered,
    )
    with capture_logs() as logs:
        await monitor.check()
        await monitor.check()
        section = StorageSection(path=tmp_path, min_free_mb=0)
        await monitor.check()
    await transactions.close()
    assert [log["event"] for log in logs] == ["storage cannot be used", "storage recovered"]
    assert "min_free_mb requires" in logs[0]["trouble"]
    assert changes == [logs[0]["trouble"], ""]
    assert len(readable) == 1, "a full disk can be read all the same"
    assert recovered == [""]


async def test_a_failed_mission_makes_it_check_at_once_and_trouble_more_often(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panoexec.daemon.storage._PERIOD_IN_TROUBLE_S", 0.01)
    full, recovered = [True], asyncio.Event()

    async def nothing() -> None: ...

    async def on_recovered() -> None:
        recovered.set()

    monkeypatch.setattr("panoexec.daemon.storage.storage_trouble", lambda _: "full" if full[0] else "")
    transactions = await Transactions.open(tmp_path / "transactions.sqlite", boot_id="boot")
    monitor = StorageMonitor(
        section=lambda: StorageSection(path=tmp_path),
        transactions=transactions,
        changed=lambda: None,
        on_readable=nothing,
        on_recovered=on_recovered,
    )
    watching = asyncio.create_task(monitor.run(), name="storage")
    monitor.check_soon()
    await eventually(lambda: monitor.trouble)
    full[0] = False
    await asyncio.wait_for(recovered.wait(), 60)
    assert monitor.trouble == ""
    watching.cancel()
    await asyncio.gather(watching, return_exceptions=True)
    await transactions.close()
