"""What `simulate` says of the way to its vehicle."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from panoexec.cli.app import run
from panoexec.sim import server
from panoexec.sim.config import SimConfig
from panoexec.sim.run_documents import Ready, Summary


@pytest.mark.parametrize(
    ("options", "ports", "connection"),
    [
        ((), "127.0.0.1:14540 and 14550", "udpin://0.0.0.0:14540"),
        (("--port", "14600"), "127.0.0.1:14600", "udpin://0.0.0.0:14600"),
        (("--listen",), "127.0.0.1:14540", "udpout://127.0.0.1:14540"),
        (("--listen", "--port", "14600"), "127.0.0.1:14600", "udpout://127.0.0.1:14600"),
    ],
)
def test_it_names_the_ports_that_it_uses(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: tuple[str, ...],
    ports: str,
    connection: str,
) -> None:
    def at_once(config: SimConfig, *, on_ready: Callable[[Ready], None], **_: Any) -> Summary:
        on_ready(Ready(config=config))
        return Summary(photos=0, written=0, failures=(), simulated_s=0.0, latest_s=0.0, interrupted=False)

    monkeypatch.setattr(server, "run_simulation", at_once)
    assert run(["simulate", *options]) == 0
    first, second, *_ = capsys.readouterr().err.splitlines()
    assert first.endswith(f" MAVLink on UDP, {ports}")
    assert f'connection = "{connection}"' in second
