"""The daemon beside a simulated vehicle and a real broker, at real time: how soon it is ready, what it costs idle.

Start counts from the creation of the process to its READY=1; idle begins when the vehicle was found. On a busy machine
only the processor times mean something, so they are given beside.
"""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from panoexec.sim.config import SimConfig
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.bench.harness import Measurement
from tests.wire.broker import running_broker

IDLE_S: Final = float(os.environ.get("PANOEXEC_BENCH_IDLE_S", "60"))
STARTS: Final = 3
_LIMIT_S: Final = 60.0
_TICK_S: Final = 1.0 / os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True, kw_only=True)
class Usage:
    """What a process has used so far, from /proc."""

    cpu_s: float
    resident_mb: float
    peak_mb: float
    threads: int
    wakeups: int


def measure() -> Iterable[Measurement]:
    """Start, then idle."""
    with tempfile.TemporaryDirectory() as folder:
        yield from asyncio.run(_measured(Path(folder)))


async def _measured(folder: Path) -> list[Measurement]:
    port = free_udp_port()
    with running_broker(folder) as broker:
        config = folder / "config.toml"
        config.write_text(
            f'[vehicle]\nconnection = "udpin://127.0.0.1:{port}"\n[mqtt]\nhost = "127.0.0.1"\nport = {broker.port}\n'
            f'[storage]\npath = "{folder}/data"\nmin_free_mb = 1\n'
        )
        async with running_simulator(SimConfig(port=port)):
            starts = [await asyncio.to_thread(_start, config, folder) for _ in range(STARTS)]
            found_s, began, ended = await asyncio.to_thread(_idle, config, folder)
    start_s, start_cpu_s = min(start[0] for start in starts), min(start[1] for start in starts)
    share = 100 * (ended.cpu_s - began.cpu_s) / IDLE_S
    return [
        Measurement(what="start to READY", ours=start_s, unit="s", goal="at most 1.5 s", met=start_s <= 1.5),
        Measurement(what="start to READY: processor", ours=start_cpu_s, unit="s"),
        Measurement(what="start to vehicle, gimbal and camera found", ours=found_s, unit="s"),
        Measurement(
            what=f"idle for {IDLE_S:g} s: processor", ours=share, unit="% of a core", goal="at most 1 %", met=share <= 1
        ),
        Measurement(
            what="idle: resident", ours=ended.resident_mb, unit="MB", goal="at most 80 MB", met=ended.resident_mb <= 80
        ),
        Measurement(what="idle: threads", ours=ended.threads, unit=""),
        Measurement(what="idle: wakeups", ours=(ended.wakeups - began.wakeups) / IDLE_S, unit="1/s"),
    ]


def _start(config: Path, folder: Path) -> tuple[float, float]:
    """Wall and processor seconds from the creation of the process to READY."""
    began = time.monotonic()
    with _daemon(config, folder) as (process, told):
        told("READY=1")
        return time.monotonic() - began, usage(process.pid).cpu_s


def _idle(config: Path, folder: Path) -> tuple[float, Usage, Usage]:
    """Seconds until the vehicle was found; what was used at the beginning and at the end of doing nothing."""
    created_s = time.monotonic()
    with _daemon(config, folder) as (process, told):
        told("vehicle ready")
        found_s = time.monotonic() - created_s
        began = usage(process.pid)
        time.sleep(IDLE_S)
        return found_s, began, usage(process.pid)


@contextmanager
def _daemon(config: Path, folder: Path) -> Iterator[tuple[subprocess.Popen[bytes], Callable[[str], None]]]:
    """The daemon, and a function that waits until it has told the service manager a word."""
    path = folder / "notify"
    path.unlink(missing_ok=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notices:
        notices.bind(str(path))
        notices.settimeout(_LIMIT_S)
        command = [sys.executable, "-m", "panoexec", "serve", "--config", str(config)]
        environment = os.environ | {"NOTIFY_SOCKET": str(path)}
        with (folder / "serve.log").open("ab") as log:
            process = subprocess.Popen(command, stderr=log, env=environment)

        def told(word: str) -> None:
            while word not in notices.recv(4096).decode():
                pass

        try:
            yield process, told
        finally:
            process.terminate()
            process.wait(_LIMIT_S)


def usage(pid: int) -> Usage:
    """Of a process, all its threads counted."""
    folder = Path(f"/proc/{pid}")
    fields = (folder / "stat").read_text().rpartition(")")[2].split()
    status = dict(line.split(":", 1) for line in (folder / "status").read_text().splitlines())
    wakeups = 0
    for task in (folder / "task").iterdir():
        each = dict(line.split(":", 1) for line in (task / "status").read_text().splitlines())
        wakeups += int(each["voluntary_ctxt_switches"])
    return Usage(
        cpu_s=(int(fields[11]) + int(fields[12])) * _TICK_S,
        resident_mb=int(status["VmRSS"].split()[0]) * 1024 / 1e6,
        peak_mb=int(status["VmHWM"].split()[0]) * 1024 / 1e6,
        threads=int(status["Threads"]),
        wakeups=wakeups,
    )
