"""The kernel drops one message and no other, on one socket and no other, until told otherwise."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from panoexec.adapters.link.bpf_filter import DatagramFilter
from panoexec.adapters.link.connection_url import parse_connection

GIMBAL = 285


def frame(message_id: int, payload: bytes = b"\x01\x02\x03", *, magic: int = 0xFD) -> bytes:
    return bytes((magic, len(payload), 0, 0, 7, 1, 154)) + message_id.to_bytes(3, "little") + payload + b"\xaa\xbb"


@pytest.fixture(name="listening")
def a_listening_socket() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        one.settimeout(10)
        yield one


def heard(listening: socket.socket, *datagrams: bytes) -> list[bytes]:
    """What of them arrives; they come in order, so the last word tells the end."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        for datagram in (*datagrams, b"end"):
            peer.sendto(datagram, listening.getsockname())
    out = []
    while (datagram := listening.recv(4096)) != b"end":
        out.append(datagram)
    return out


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def mute_on(listening: socket.socket) -> DatagramFilter:
    return DatagramFilter(parse_connection(f"udpin://127.0.0.1:{listening.getsockname()[1]}"), GIMBAL)


def test_drops_that_message_alone(listening: socket.socket) -> None:
    others = [frame(0), frame(30), frame(285 + 0x10000), frame(0x11D ^ 0x100), frame(GIMBAL, magic=0xFE), b"", b"\xfd"]
    bundled = frame(GIMBAL) + frame(0)
    mute = mute_on(listening)
    mute.mute()
    assert heard(listening, frame(GIMBAL), *others, frame(GIMBAL, bytes(48)), bundled) == [*others, bundled]
    mute.mute()  # twice does no harm
    mute.unmute()
    assert heard(listening, frame(GIMBAL), *others) == [frame(GIMBAL), *others]
    mute.unmute()


def test_follows_the_socket_when_the_connection_is_opened_anew(listening: socket.socket) -> None:
    mute = mute_on(listening)
    mute.mute()
    address = listening.getsockname()
    listening.close()
    mute.unmute()  # nobody there
    mute.mute()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(address)  # nothing of ours holds the port
        again.settimeout(10)
        assert heard(again, frame(GIMBAL)) == [frame(GIMBAL)]
        mute.mute()
        assert heard(again, frame(GIMBAL)) == []


def test_leaves_other_links_alone_and_no_descriptor_open(listening: socket.socket) -> None:
    before = descriptors()
    port = listening.getsockname()[1]
    for url in (f"udpout://127.0.0.1:{port}", f"tcpin://127.0.0.1:{port}", "serial:///dev/ttyACM0:57600"):
        DatagramFilter(parse_connection(url), GIMBAL).mute()
    assert heard(listening, frame(GIMBAL)) == [frame(GIMBAL)]
    mute_on(listening).mute()
    assert descriptors() == before
