"""Which program uses a port or a device."""

from __future__ import annotations

import os
import pty
import socket
import subprocess
import sys
from pathlib import Path

from panoexec.adapters.link.connection_url import parse_connection
from panoexec.adapters.link.occupancy import occupant
from panoexec.sim.ports import free_udp_port

HOLD_PORT = (
    "import socket,sys; s=socket.socket(socket.AF_INET,socket.SOCK_DGRAM); s.bind(('127.0.0.1',int(sys.argv[1])))"
)
HOLD_FILE = "import sys; f=open(sys.argv[1])"
WAIT = "; print('held', flush=True); sys.stdin.read()"


def holding(code: str, argument: str) -> subprocess.Popen[bytes]:
    process = subprocess.Popen(
        [sys.executable, "-c", code + WAIT, argument], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"held\n"
    return process


def test_a_port_names_the_process_that_listens_on_it() -> None:
    port = free_udp_port()
    url = parse_connection(f"udpin://127.0.0.1:{port}")
    assert occupant(url) == ""
    with holding(HOLD_PORT, str(port)) as process:
        assert occupant(url).startswith(f"UDP port {port} is in use by process {process.pid} (python")
        process.communicate()
    assert occupant(url) == ""


def test_a_process_of_somebody_else_is_another_program(tmp_path: Path) -> None:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        port = listener.getsockname()[1]
        url = parse_connection(f"tcpin://127.0.0.1:{port}")
        assert occupant(url, proc=tmp_path) == f"TCP port {port} is in use by another program"


def test_a_serial_device_is_found_by_any_of_its_names(tmp_path: Path) -> None:
    master, slave = pty.openpty()
    device = os.ttyname(slave)
    os.close(slave)
    name = tmp_path / "usb-autopilot"
    name.symlink_to(device)
    url = parse_connection(f"serial://{name}:57600")
    try:
        assert occupant(url) == ""
        with holding(HOLD_FILE, device) as process:
            assert occupant(url).startswith(f"{name} is in use by process {process.pid} (python")
            process.communicate()
    finally:
        os.close(master)


def test_a_connection_to_elsewhere_occupies_nothing() -> None:
    assert occupant(parse_connection("udpout://127.0.0.1:14550")) == ""
    assert occupant(parse_connection("tcpout://127.0.0.1:5760")) == ""
