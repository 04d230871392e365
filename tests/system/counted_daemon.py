"""The daemon as `panoexec serve` runs it, which writes down what it holds when it gets SIGUSR1.

Arguments: configuration, speed-up, file to write to.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import os
import signal
import sys
import threading
from collections import Counter
from pathlib import Path

from panoexec.cli.serve import checked_config
from panoexec.clock import SystemClock
from panoexec.daemon.daemon import Daemon
from panoexec.daemon.sdnotify import SystemdNotifier
from panoexec.files import write_atomically
from panoexec.logs import configure_logs


def resting(daemon: Daemon) -> bool:
    """Whether the last mission's files are closed, and the streams are slow again, as a daemon that waits has them."""
    link = daemon.vehicle._link
    return (
        not daemon.missions.busy
        and not any("/missions/" in name for name in open_files())
        and link is not None
        and not link.streams.active
        and all(
            report.measured_hz <= 1.5 * report.wanted_hz + 1.0
            for report in link.streams.reports()
            # a gimbal that is its own component sends as often as it likes
            if report.stream.name != "GIMBAL_DEVICE_ATTITUDE_STATUS"
        )
    )


def open_files() -> list[str]:
    """What the open descriptors lead to."""
    out = []
    for descriptor in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # that of the look itself
            out.append(str(descriptor.readlink()))
    return sorted(out)


async def serve(config_file: Path, speedup: float, counts: Path) -> None:
    """Run until SIGTERM."""
    config = checked_config(config_file, os.environ)
    configure_logs("warning", "json")
    daemon = Daemon(
        config,
        clock=SystemClock(speedup),
        reload=lambda: checked_config(config_file, os.environ),
        notifier=SystemdNotifier(),
    )

    def count() -> None:
        gc.collect()
        resident = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmRSS"))
        held = {
            "resident_mb": int(resident.split()[1]) / 1000,
            "tasks": len(asyncio.all_tasks()),
            "threads": threading.active_count(),
            "native_threads": len(list(Path("/proc/self/task").iterdir())),
            "files": len(files := open_files()),
            "open": files,
            "objects": len(gc.get_objects()),
            "resting": resting(daemon),
            "kinds": Counter(type(one).__qualname__ for one in gc.get_objects()).most_common(200),
        }
        write_atomically(counts, json.dumps(held))

    asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, count)
    await daemon.run()


if __name__ == "__main__":
    asyncio.run(serve(Path(sys.argv[1]), float(sys.argv[2]), Path(sys.argv[3])))
