"""Run the benchmarks: `python -m tests.bench [NAME ...] [--json]`.

A benchmark is a module `tests/bench/bench_NAME.py` with `measure() -> Iterable[Measurement]`. Absolute times depend on
the machine; the ratios between peers of one run are what counts. Exit code 1: a goal was missed.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import json
import platform
import sys
from pathlib import Path

import numpy as np

from tests.bench.harness import Measurement

_ONLY_NAMED = {"survey"}
"""Benchmarks that take long, and run only where they are named."""


def main() -> int:
    """Run and print them; the exit code."""
    available = sorted(path.stem.removeprefix("bench_") for path in Path(__file__).parent.glob("bench_*.py"))
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench", description=__doc__.splitlines()[0] if __doc__ else ""
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"which: {', '.join(available)} (all but survey)")
    parser.add_argument("--json", action="store_true", help="one JSON document on stdout")
    args = parser.parse_args()
    for name in args.names:
        if name not in available:
            parser.error(f"there is no benchmark {name!r}: there are {', '.join(available)}")
    results: dict[str, list[Measurement]] = {}
    if not args.json:
        print(f"Python {platform.python_version()}, numpy {np.__version__}, {platform.machine()}", flush=True)
    for name in args.names or [name for name in available if name not in _ONLY_NAMED]:
        if not args.json:
            print(f"\n{name}", flush=True)
        results[name] = []
        for measurement in importlib.import_module(f"tests.bench.bench_{name}").measure():
            results[name].append(measurement)
            if not args.json:
                print(line(measurement), flush=True)
    if args.json:
        json.dump(
            {name: [dataclasses.asdict(m) | {"ratio": m.ratio} for m in found] for name, found in results.items()},
            sys.stdout,
            indent=1,
        )
        print()
    return 1 if any(m.met is False for found in results.values() for m in found) else 0


def line(m: Measurement) -> str:
    """One measurement as a line for a person."""
    text = f"  {m.what}: {m.ours:.4g} {m.unit}"
    if m.theirs is not None and m.ratio is not None:
        text += f"; {m.peer}: {m.theirs:.4g} {m.unit}; ratio {m.ratio:.4g}"
    if m.goal:
        text += f"   [goal {m.goal}: {'met' if m.met else 'MISSED'}]"
    return text


if __name__ == "__main__":
    sys.exit(main())
