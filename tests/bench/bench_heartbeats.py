"""How long an autopilot is without heartbeats when the daemon is killed, and how long it still has them when it hangs.

ArduPilot's script `companion_watchdog` lands a copter in GUIDED 3 s after the last heartbeat.
"""

from __future__ import annotations

import os
import signal
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from statistics import median
from typing import Final

from tests.bench.harness import Measurement
from tests.repository import ROOT
from tests.system.beating_daemon import BeatingDaemon

KILLS: Final = int(os.environ.get("PANOEXEC_BENCH_KILLS", "10"))
FREEZES: Final = int(os.environ.get("PANOEXEC_BENCH_FREEZES", "5"))
_FROZEN_S: Final = 6.0


def measure() -> Iterable[Measurement]:
    """Kills, then freezes."""
    with tempfile.TemporaryDirectory() as folder:
        gaps, lasting = _gaps(Path(folder)), _lasting(Path(folder))
    yield Measurement(what=f"{KILLS} kills: without heartbeats, median", ours=median(gaps), unit="s")
    yield _at_most("longest", max(gaps), 2.5)
    yield Measurement(what=f"{FREEZES} frozen loops: heartbeats go on, median", ours=median(lasting), unit="s")
    yield _at_most("longest", max(lasting), 3.0)


def _at_most(what: str, ours: float, goal_s: float) -> Measurement:
    return Measurement(what=what, ours=ours, unit="s", goal=f"at most {goal_s:g} s", met=ours <= goal_s)


def restart_s() -> float:
    """RestartSec= of the unit."""
    (line,) = [
        line
        for line in (ROOT / "systemd" / "panoexec.service").read_text().splitlines()
        if line.startswith("RestartSec=")
    ]
    return float(line.partition("=")[2].removesuffix("ms")) / 1000


def _gaps(folder: Path) -> list[float]:
    """From the last heartbeat before a SIGKILL to the first one after the restart."""
    gaps, wait_s = [], restart_s()
    daemon = BeatingDaemon(folder, frozen_s=_FROZEN_S, listens=True)
    daemon.start()
    for _ in range(KILLS):
        daemon.next_beat()
        daemon.beats(2.3)
        daemon.signal(signal.SIGKILL)
        daemon.beats(wait_s)
        last_s = daemon.last_s
        daemon.start()
        gaps.append(daemon.next_beat() - last_s)
    daemon.close()
    return gaps


def _lasting(folder: Path) -> list[float]:
    """From the moment at which the loop stands still to the last heartbeat."""
    lasting = []
    daemon = BeatingDaemon(folder, frozen_s=_FROZEN_S)
    daemon.start()
    daemon.next_beat()
    time.sleep(3.0)
    for _ in range(FREEZES):
        daemon.beats(3.0)
        since_s = daemon.freeze()
        lasting.append(max([0.0, *(beat - since_s for beat in daemon.beats(_FROZEN_S - 0.5))]))
        daemon.next_beat()
    daemon.close()
    return lasting
