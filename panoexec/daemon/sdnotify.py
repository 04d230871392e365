"""Notifications to systemd (readiness, status, watchdog): sd_notify(3) without libsystemd."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping


class SystemdNotifier:
    """Sends notifications to the service manager; does nothing without one.

    A notification that cannot be sent is dropped: the daemon must not fail because the service manager is busy.
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
        """Watchdog timeout in seconds (WATCHDOG_USEC), None if the watchdog is off."""
        return self._watchdog_s

    def ready(self, status: str) -> None:
        """The service is up (READY=1)."""
        self._send(f"READY=1\nSTATUS={_one_line(status)}")

    def status(self, status: str) -> None:
        """Set the status line of `systemctl status` (STATUS=)."""
        self._send(f"STATUS={_one_line(status)}")

    def watchdog(self) -> None:
        """Keep-alive ping of the watchdog (WATCHDOG=1)."""
        self._send("WATCHDOG=1")

    def reloading(self, monotonic_usec: int) -> None:
        """A reload begins (RELOADING=1); `ready` ends it. The stamp is CLOCK_MONOTONIC in microseconds."""
        self._send(f"RELOADING=1\nMONOTONIC_USEC={monotonic_usec}")

    def stopping(self, status: str) -> None:
        """The service is stopping (STOPPING=1)."""
        self._send(f"STOPPING=1\nSTATUS={_one_line(status)}")

    def extend_timeout(self, seconds: float) -> None:
        """Extend the timeout of start or stop (EXTEND_TIMEOUT_USEC=)."""
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
