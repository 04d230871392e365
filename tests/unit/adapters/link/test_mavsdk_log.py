"""MAVSDK's log is subscribed once: its Python frees the trampoline of an earlier one while it may be called."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import mavsdk
import pytest

from panoexec.adapters.link import mavsdk_errors


def test_links_that_are_opened_at_once_subscribe_once(monkeypatch: pytest.MonkeyPatch) -> None:
    subscribed: list[object] = []
    both = threading.Barrier(4)
    monkeypatch.setattr(mavsdk, "log_subscribe", subscribed.append)
    monkeypatch.setattr(mavsdk_errors, "_log_bridge", mavsdk_errors._LogBridge())

    def open_one() -> None:
        both.wait(60)
        mavsdk_errors.quiet_mavsdk_log()

    with ThreadPoolExecutor(4) as pool:
        for each in [pool.submit(open_one) for _ in range(4)]:
            each.result()
    mavsdk_errors.quiet_mavsdk_log()
    assert len(subscribed) == 1
