"""What a command costs before it does anything: processor time until its help, beside an interpreter with asyncio."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence

from tests.bench.harness import Measurement
from tests.unit.cli.test_quick_commands import MAP

_REPEATS = 5
_MOST_S = 0.4
_QUICK = ("send", "watch", "start", "status", "abort")
_PEER = ("-c", "import argparse, asyncio, json, ssl")


def measure() -> Iterator[Measurement]:
    """The quick commands, and `watch` until its first map is drawn."""
    peer = _least_s(_PEER)
    for verb in _QUICK:
        yield _measured(f"panoexec {verb} --help", ("-m", "panoexec", verb, "--help"), peer)
    yield _measured("what panoexec watch loads until its first map", ("-c", f"import panoexec.cli.watch\n{MAP}"), peer)


def _measured(what: str, arguments: Sequence[str], peer: float) -> Measurement:
    took = _least_s(arguments)
    return Measurement(
        what=f"{what}, processor time",
        ours=took,
        unit="s",
        peer="Python with asyncio, json and ssl",
        theirs=peer,
        goal=f"at most {_MOST_S:g} s",
        met=took <= _MOST_S,
    )


def _least_s(arguments: Sequence[str]) -> float:
    """Least processor time of a Python program of several runs, seconds."""
    return min(_took_s(arguments) for _ in range(_REPEATS))


def _took_s(arguments: Sequence[str]) -> float:
    before = os.times()
    subprocess.run([sys.executable, *arguments], check=True, capture_output=True)
    after = os.times()
    return after.children_user - before.children_user + after.children_system - before.children_system
