import os
import socket
from pathlib import Path

import pytest

from panoexec.daemon.sdnotify import SystemdNotifier


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path):  # type: ignore[no-untyped-def]
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    sock.settimeout(2)
    name = str(tmp_path / "notify") if request.param == "path" else f"@panoexec-test-{os.getpid()}"
    sock.bind("\0" + name[1:] if name.startswith("@") else name)
    with sock:
        yield sock, name


def test_notices_reach_the_manager(manager: tuple[socket.socket, str]) -> None:
    sock, name = manager
    notifier = SystemdNotifier({"NOTIFY_SOCKET": name})
    notifier.ready("shot 0/25\nwaiting")
    assert sock.recv(4096) == b"READY=1\nSTATUS=shot 0/25 waiting"
    notifier.watchdog()
    assert sock.recv(4096) == b"WATCHDOG=1"
    notifier.extend_timeout(2.5)
    assert sock.recv(4096) == b"EXTEND_TIMEOUT_USEC=2500000"
    notifier.reloading(17)
    assert sock.recv(4096) == b"RELOADING=1\nMONOTONIC_USEC=17"
    notifier.stopping("bye")
    assert sock.recv(4096) == b"STOPPING=1\nSTATUS=bye"


def test_without_a_manager_nothing_happens() -> None:
    notifier = SystemdNotifier({})
    notifier.ready("up")
    assert notifier.watchdog_s is None
    SystemdNotifier({"NOTIFY_SOCKET": "/nowhere/at/all"}).watchdog()


@pytest.mark.parametrize(
    ("environment", "seconds"),
    [
        ({"WATCHDOG_USEC": "30000000"}, 30.0),
        ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "7"}, 30.0),
        ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "8"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
    ],
)
def test_the_watchdog_interval_is_meant_for_one_process(environment: dict[str, str], seconds: float | None) -> None:
    assert SystemdNotifier(environment, pid=7).watchdog_s == seconds
