"""Readiness, status and watchdog notices to systemd: sd_notify(3) without its library."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping


class SystemdNotifier:
    """Sends notices to the service manager; does nothing where there is none.

    A notice that cannot be sent is dropped: a daemon must not fail because its supervisor is busy.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ, *, pid: int | None = None) -> None:
        """Read NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID from the environment."""
        address = environment.get("NOTIFY_SOCKET", "")
        # a leading @ names a socket in Linux' abstract namespace
        self._address = "\0" + address[1:] if address.startswith("@") else address
        watchdog_pid = environment.get("WATCHDOG_PID", "")
        usec = environment.get("WATCHDOG_USEC", "")
        ours = not watchdog_pid or watchdog_pid == str(os.getpid() if pid is None else pid)
        self._watchdog_s = int(usec) / 1e6 if ours and usec.isdigit() and int(usec) > 0 else None

    @property
    def watchdog_s(self) -> float | None:
        """Seconds after which the service manager takes us for dead without `watchdog()`, None if it does not watch."""
        return self._watchdog_s

    def ready(self, status: str) -> None:
        """The service is up (READY=1)."""
        self._send(f"READY=1\nSTATUS={_one_line(status)}")

    def status(self, status: str) -> None:
        """What `systemctl status` shows."""
        self._send(f"STATUS={_one_line(status)}")

    def watchdog(self) -> None:
        """A sign of life."""
        self._send("WATCHDOG=1")

    def reloading(self, monotonic_usec: int) -> None:
        """A reload begins; `ready` ends it. The stamp is CLOCK_MONOTONIC in microseconds."""
        self._send(f"RELOADING=1\nMONOTONIC_USEC={monotonic_usec}")

    def stopping(self, status: str) -> None:
        """The service is going down."""
        self._send(f"STOPPING=1\nSTATUS={_one_line(status)}")

    def extend_timeout(self, seconds: float) -> None:
        """Start or stop takes longer: do not kill us for so long."""
        self._send(f"EXTEND_TIMEOUT_USEC={round(seconds * 1e6)}")

    def _send(self, message: str) -> None:
        if not self._address:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sock:
            try:
                sock.setblocking(False)
                sock.sendto(message.encode(), self._address)
            except OSError:
                return


def _one_line(text: str) -> str:
    return " ".join(text.split())
