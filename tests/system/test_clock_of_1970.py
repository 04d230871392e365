"""A real daemon whose clock begins at 1970, as on a companion computer without a battery-backed clock.

`PANOEXEC_FAKETIME` is the path of libfaketimeMT.so.1 (Debian package libfaketime), which gives the process its clock.
"""

from __future__ import annotations

import asyncio
import os
import sys
from pathlib import Path

import pytest

from tests.unit.store.test_catalogue import FLYING, NOW, OVER, _mission
from tests.waiting import eventually
from tests.wire.certificates import Authority, needs_openssl

LIBRARY = os.environ.get("PANOEXEC_FAKETIME", "")
pytestmark = [needs_openssl, pytest.mark.skipif(not LIBRARY, reason="PANOEXEC_FAKETIME is not set")]


async def test_the_interrupted_mission_is_found_and_tls_says_what_the_clock_says(tmp_path: Path) -> None:
    await _mission(tmp_path / "data", NOW, *OVER)
    interrupted = await _mission(tmp_path / "data", 45.0, *FLYING)
    authority = Authority(tmp_path / "ca")
    mine = authority.issue("drone")
    config, log = tmp_path / "config.toml", tmp_path / "log"
    config.write_text(
        '[vehicle]\nconnection = "udpin://127.0.0.1:14999"\n'
        f'[mqtt]\nhost = "127.0.0.1"\nport = 18899\nca_file = "{authority.cert}"\n'
        f'cert_file = "{mine.cert}"\nkey_file = "{mine.key}"\n'
        f'[storage]\npath = "{tmp_path}/data"\nmin_free_mb = 1\n'
    )
    faked = {"LD_PRELOAD": LIBRARY, "FAKETIME": "@1970-01-01 00:01:00", "FAKETIME_DONT_FAKE_MONOTONIC": "1"}
    with log.open("wb") as out:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "panoexec", "serve", "--config", str(config)),
            stdout=out,
            stderr=out,
            env=os.environ | faked,
        )
    try:
        told = (
            f'"mission_id": "{interrupted.mission_id}", "state": "capturing", "event": "an interrupted mission can be',
            "is not valid before 2025-01-01 00:00 UTC: set the clock of this computer, which says 1970-01-01 00:01 UTC",
        )
        await eventually(lambda: all(text in log.read_text() for text in told), 60)
        await eventually(interrupted.report.exists, 60)
        assert process.returncode is None
    finally:
        if process.returncode is None:
            process.terminate()
        await process.wait()
