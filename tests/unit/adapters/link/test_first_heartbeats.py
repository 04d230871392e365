"""The heartbeat that a listening port sends before MAVSDK has it."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator

import pytest

from panoexec.adapters.link import first_heartbeats
from panoexec.adapters.link.first_heartbeats import heartbeat, open_at_once
from panoexec.inputs.vehicle_sections import VehicleSection
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.ports import free_udp_port

PACKETS_S = 0.01


def test_it_is_one_of_mavlink() -> None:
    (message,) = mavlink.MAVLink(None).parse_buffer(heartbeat(7, 192))
    assert (message.get_type(), message.get_srcSystem(), message.get_srcComponent()) == ("HEARTBEAT", 7, 192)
    assert (message.type, message.autopilot, message.mavlink_version) == (0, mavlink.MAV_AUTOPILOT_INVALID, 3)


@pytest.fixture
def port() -> int:
    return free_udp_port()


@contextlib.contextmanager
def sender(port: int) -> Iterator[socket.socket]:
    """Sends packets to the port, as a vehicle does."""
    over = threading.Event()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))

        def send() -> None:
            while not over.wait(PACKETS_S):
                one.sendto(b"\xfd", ("127.0.0.1", port))

        thread = threading.Thread(target=send)
        thread.start()
        try:
            yield one
        finally:
            over.set()
            thread.join()


def test_whoever_sends_to_a_listening_port_has_it_when_the_connection_is_open(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(first_heartbeats, "_FIRST_S", 20.0)
    monkeypatch.setattr(first_heartbeats, "_OTHERS_S", 1.0)  # in which each thread gets time to send
    with sender(port) as one, sender(port) as other:
        opened = open_at_once(VehicleSection(connection=f"udpin://127.0.0.1:{port}", component_id=192))
        assert opened is not None
        try:
            for each in (one, other):
                each.setblocking(False)
                assert each.recv(100) == heartbeat(1, 192)
        finally:
            opened.close()


def test_silence_and_a_port_in_use_are_no_errors(port: int) -> None:
    section = VehicleSection(connection=f"udpin://127.0.0.1:{port}")
    opened = open_at_once(section)
    assert opened is not None
    try:
        assert open_at_once(section) is None
    finally:
        opened.close()
