"""Heartbeats come from a daemon that works, and from no other (figures: `python -m tests.bench heartbeats`)."""

from __future__ import annotations

import contextlib
import itertools
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.system.beating_daemon import BeatingDaemon

FROZEN_S = 6.0


@pytest.fixture
def beating(tmp_path: Path) -> Iterator[BeatingDaemon]:
    with contextlib.closing(BeatingDaemon(tmp_path, frozen_s=FROZEN_S)) as daemon:
        yield daemon


def test_a_frozen_loop_has_no_heartbeats_and_is_back_afterwards(beating: BeatingDaemon) -> None:
    beating.start()
    beating.next_beat()
    while b"vehicle not ready" not in beating.log.read_bytes():  # the event loop runs
        beating.beats(0.2)
    since_s = beating.freeze()
    beats = [since_s, *beating.beats(FROZEN_S), beating.next_beat()]
    silent_s = max(after - before for before, after in itertools.pairwise(beats))
    assert silent_s > FROZEN_S / 2, beats
    assert b"the event loop stood still" in beating.log.read_bytes()
    beating.next_beat()


def test_a_computer_that_stands_still_as_a_whole_is_not_taken_for_a_frozen_loop(beating: BeatingDaemon) -> None:
    beating.start()
    beating.next_beat()
    while b"vehicle not ready" not in beating.log.read_bytes():
        beating.beats(0.2)
    beating.signal(signal.SIGSTOP)
    time.sleep(3.0)
    beating.beats(0.1)  # what was under way
    beating.signal(signal.SIGCONT)
    beating.next_beat()
    assert b"stood still" not in beating.log.read_bytes()


def test_heartbeats_begin_before_the_daemon_is_loaded() -> None:
    program = """
import sys
from panoexec.cli import serve
def opened(section):
    print(*sorted({"numpy", "panoexec.daemon.daemon", "panoexec.mission.executor"} & set(sys.modules)))
    raise SystemExit(0)
serve.open_at_once = opened
from panoexec.__main__ import main
sys.argv = ["panoexec", "serve", "--config", "config/panoexec.toml"]
main()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "\n"), done.stderr
