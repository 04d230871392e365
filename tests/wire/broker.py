"""A real mosquitto on a free port, started, stopped and restarted by tests."""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from panoexec.sim.ports import free_tcp_port

PATH = os.environ.get("PATH", "") + os.pathsep + "/usr/sbin" + os.pathsep + "/usr/local/sbin"
MOSQUITTO = shutil.which("mosquitto", path=PATH)

needs_mosquitto = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed (apt-get install mosquitto)")


class Broker:
    """One mosquitto with a configuration of its own; what it says is in `log`."""

    def __init__(
        self,
        folder: Path,
        *,
        listener: str = "",
        settings: str = "allow_anonymous true",
        persistent: bool = False,
        verbose: bool = True,
        port: int | None = None,
        whole: str = "",
    ) -> None:
        self.port = port or free_tcp_port()
        self._verbose = ["-v"] if verbose else []
        self.log = folder / "mosquitto.log"
        self._config = folder / "mosquitto.conf"
        user = "user root\n" if os.geteuid() == 0 else ""
        kept = f"true\npersistence_location {folder}/" if persistent else "false"
        self._config.write_text(
            f"{user}{whole}\n"
            if whole
            else f"listener {self.port} 127.0.0.1\n{listener}\n{user}persistence {kept}\n"
            f"max_inflight_messages 0\nmax_queued_messages 100000\n{settings}\n"
        )
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it and wait until it listens."""
        assert MOSQUITTO is not None
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                [MOSQUITTO, "-c", str(self._config), *self._verbose], stdout=log, stderr=log
            )
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), timeout=1):
                return
            if self._process.poll() is not None:
                break
            time.sleep(0.01)
        raise AssertionError(f"mosquitto did not start: {self.log.read_text()}")

    def stop(self, *, kill: bool = False) -> None:
        """Stop it; `kill` as a crash does."""
        if self._process is not None:
            if kill:
                self._process.kill()
            else:
                self._process.terminate()
            self._process.wait(60)
            self._process = None

    def cpu_s(self) -> float:
        """Seconds of a core that it has used."""
        assert self._process is not None
        stat = Path(f"/proc/{self._process.pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return (int(stat[11]) + int(stat[12])) / os.sysconf("SC_CLK_TCK")

    def resident_mb(self) -> float:
        """Memory that it holds."""
        assert self._process is not None
        lines = Path(f"/proc/{self._process.pid}/status").read_text(encoding="utf-8").splitlines()
        return int(next(line for line in lines if line.startswith("VmRSS")).split()[1]) / 1000


@contextlib.contextmanager
def running_broker(
    folder: Path,
    *,
    listener: str = "",
    settings: str = "allow_anonymous true",
    persistent: bool = False,
    verbose: bool = True,
    port: int | None = None,
    whole: str = "",
) -> Iterator[Broker]:
    """A broker while the block runs; a `persistent` one keeps sessions and what is retained when it is stopped.

    With `whole`, a configuration file's text for `port`, the other options do not count.
    """
    broker = Broker(
        folder, listener=listener, settings=settings, persistent=persistent, verbose=verbose, port=port, whole=whole
    )
    broker.start()
    try:
        yield broker
    finally:
        broker.stop(kill=True)
