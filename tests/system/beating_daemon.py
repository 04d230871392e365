"""A daemon whose heartbeats are listened to, and which can be killed, and frozen."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Final

from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.ports import free_udp_ports
from tests.wire.sim_peer import UdpPeer

_PACKETS_S: Final = 0.05
_PROGRAM = """
import signal, sys, time
from panoexec.__main__ import main
# Python calls this in the thread of the event loop, between two of its steps: the loop stands still
signal.signal(signal.SIGUSR1, lambda *_: time.sleep({frozen_s}))
sys.exit(main())
"""


class BeatingDaemon:
    """A `serve` on a UDP link on which nobody answers.

    Args:
        folder: for its configuration, storage and log.
        frozen_s: how long `freeze` lasts.
        listens: it waits for packets, as by default, and an autopilot sends some, instead of sending by itself.
    """

    def __init__(self, folder: Path, *, frozen_s: float, listens: bool = False) -> None:
        self.log = folder / "serve.log"
        port, own = free_udp_ports(2)
        self._peer = UdpPeer(own if listens else port)
        self._over = threading.Event()
        if listens:
            self._peer.talk_to(("127.0.0.1", port))
            threading.Thread(target=self._talk, name="autopilot", daemon=True).start()
        self._config = folder / "config.toml"
        kind = "udpin" if listens else "udpout"
        self._config.write_text(
            f'[vehicle]\nconnection = "{kind}://127.0.0.1:{port}"\n[storage]\npath = "{folder}/data"\nmin_free_mb = 1\n'
        )
        self._program = _PROGRAM.format(frozen_s=frozen_s)
        self._process: subprocess.Popen[bytes] | None = None
        self.last_s = -1.0
        """When the last heartbeat came, time.monotonic."""

    def start(self) -> float:
        """Start the process; returns when."""
        command = [sys.executable, "-c", self._program, "serve", "--config", str(self._config)]
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(command, stderr=log)
        return time.monotonic()

    def signal(self, number: signal.Signals) -> float:
        """Send a signal; returns when."""
        assert self._process is not None
        self._process.send_signal(number)
        if number in {signal.SIGKILL, signal.SIGTERM}:
            self._process.wait(30)
        return time.monotonic()

    def close(self) -> None:
        """End the process, if it runs."""
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait(30)
        self._over.set()
        self._peer.close()

    def _talk(self) -> None:
        while not self._over.wait(_PACKETS_S):
            with contextlib.suppress(OSError):
                self._peer.send(mavlink.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0), component=1)

    def freeze(self) -> float:
        """Let the event loop stand still; returns since when."""
        return self.signal(signal.SIGUSR1)

    def beats(self, seconds: float) -> list[float]:
        """The times of the heartbeats in the next seconds, time.monotonic."""
        heard = [one.time_s for one in self._peer.listen(seconds) if one.name == "HEARTBEAT" and one.component == 191]
        self.last_s = max([self.last_s, *heard])
        return heard

    def next_beat(self, limit_s: float = 30.0) -> float:
        """When the next heartbeat came."""
        end_s = time.monotonic() + limit_s
        while time.monotonic() < end_s:
            if heard := self.beats(0.05):
                return heard[0]
        raise TimeoutError(f"no heartbeat within {limit_s:g} s: {self.log.read_text()[-500:]}")
