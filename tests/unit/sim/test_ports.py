"""Free ports: none that the kernel may hand out to somebody else meanwhile."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from panoexec.sim import ports


def test_no_port_is_of_the_kernels_range_and_none_is_given_twice() -> None:
    first = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text(encoding="ascii").split()[0])
    if first < 22_000:
        pytest.skip(f"this kernel hands out all ports from {first}")
    given = [*ports.free_udp_ports(50), ports.free_udp_port()]
    assert len(set(given)) == 51
    assert all(20_000 <= port < first for port in [*given, ports.free_tcp_port()])


def test_a_port_in_use_is_not_given(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", ports.free_udp_port()))
        monkeypatch.setattr(ports, "_given", set())
        in_use = int(taken.getsockname()[1])
        picks = iter([in_use, *(20_001 + number for number in range(100))])
        monkeypatch.setattr(ports._random, "randrange", lambda _least, _first: next(picks))
        assert ports.free_udp_port() in range(20_001, 20_101)


def test_a_kernel_that_hands_out_nearly_all_ports_chooses_itself(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    told = tmp_path / "range"
    told.write_text("1024\t65535\n", encoding="ascii")
    monkeypatch.setattr(ports, "_RANGE", told)
    assert ports.free_tcp_port() > 0
    monkeypatch.setattr(ports, "_RANGE", tmp_path / "none")
    assert ports.free_tcp_port() < 32_768


def test_a_host_that_cannot_be_bound_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ports, "_HOST", "192.0.2.1")  # for documents: no machine has it
    with pytest.raises(OSError, match="assign requested address"):
        ports.free_udp_port()
