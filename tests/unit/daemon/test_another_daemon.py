"""While another daemon publishes as this vehicle, no mission begins; everything else is obeyed."""

from __future__ import annotations

from pathlib import Path

import pytest

from panoexec.clock import SystemClock
from panoexec.daemon.daemon import Daemon
from panoexec.daemon.sdnotify import SystemdNotifier
from panoexec.inputs.config import Config
from panoexec.mqtt.parsing import parse_request
from panoexec.mqtt.requests import RefusedRequestError


@pytest.fixture
def daemon(tmp_path: Path) -> Daemon:
    config = Config.model_validate({"mqtt": {"host": "127.0.0.1"}, "storage": {"path": tmp_path}})
    return Daemon(config, clock=SystemClock(), reload=lambda: config, notifier=SystemdNotifier({}))


@pytest.mark.parametrize("command", ["start", "resume", "pause", "abort", "finish", "get"])
def test_only_what_begins_a_mission_is_refused(daemon: Daemon, command: str) -> None:
    request = parse_request(command, b'{"transaction": 1}')
    daemon._check_alone(request)
    assert daemon.mqtt is not None
    daemon.mqtt._twins._boot_id = "mine"
    daemon.mqtt._hear_state(b'{"boot_id": "other"}', retained=False)
    assert "another daemon publishes as this vehicle" in daemon._publisher._not_ready_reason
    if command in ("start", "resume"):
        with pytest.raises(RefusedRequestError, match="another daemon") as refused:
            daemon._check_alone(request)
        assert refused.value.code == "refused"
    else:
        daemon._check_alone(request)
