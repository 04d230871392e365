"""Processes that tests start: which are left, and who ends them if the run itself is killed.

A run marks its environment, which every process inherits, and pytest names there the test that is under way.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

MARK = "PYTEST_RUN_OF_PANOEXEC"
_TEST = b"PYTEST_CURRENT_TEST="
_END_S = float(os.environ.get("PYTEST_LEFTOVERS_S", "10"))
"""What the last tests have ended may take so long to be gone."""

_GUARD = """
import sys, time
sys.path.insert(0, sys.argv[2])
from tests.leftovers import end_all, left
sys.stdin.buffer.read()  # the kernel closes it when the run is over, however it ended
end_all(sys.argv[1])
while left(sys.argv[1], workers=True):  # these end by themselves, but not at once
    time.sleep(0.5)
    end_all(sys.argv[1])
"""


class Guard:
    """Ends what a run has started when the run is over, even if it was killed."""

    def __init__(self) -> None:
        self.run = f"{os.getpid()}-{time.monotonic_ns()}"
        os.environ[MARK] = self.run
        root = str(Path(__file__).parent.parent)
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", _GUARD, self.run, root],
            stdin=subprocess.PIPE,
            start_new_session=True,  # a signal to the group of the run is not for it
            env={name: value for name, value in os.environ.items() if name != MARK},
        )

    def close(self) -> dict[int, str]:
        """End it, and what is left of the run: process ids, with the test that started each and its command line."""
        end_s = time.monotonic() + _END_S
        while (found := left(self.run)) and time.monotonic() < end_s:
            time.sleep(0.05)
        end_all(self.run)
        self._process.communicate()
        return found


def left(run: str, *, workers: bool = False) -> dict[int, str]:
    """What tests of a run have started and still runs, with the test that started it.

    Args:
        run: its mark.
        workers: the processes in which tests run, too.
    """
    wanted = f"{MARK}={run}".encode()
    found = {}
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit():
            continue
        with contextlib.suppress(OSError):  # it has ended, or is somebody else's
            environment = (folder / "environ").read_bytes().split(b"\0")  # that of a zombie is empty
            test = next((one.removeprefix(_TEST) for one in environment if one.startswith(_TEST)), b"")
            if (test or workers) and wanted in environment:
                command = (folder / "cmdline").read_bytes().replace(b"\0", b" ").strip()
                found[int(folder.name)] = f"{test.decode(errors='replace')}: {command.decode(errors='replace')}"
    return found


def end_all(run: str) -> None:
    """Kill what is left of a run, and what that has started meanwhile."""
    while found := left(run):
        for process in found:
            with contextlib.suppress(OSError):
                os.kill(process, signal.SIGKILL)
        time.sleep(0.05)
