"""`python -m panoexec.sim`: the simulated vehicle as a process, for programs that start it (`panoexec.sim.process`).

With `--config-from-stdin` the configuration is one line of JSON on standard input, and the simulation ends at the end
of standard input, so that it cannot outlive its parent; with `--leashed` as well, simulated time is limited by the
lines that follow (`panoexec.sim.pacing`). On standard output: one line of JSON when it is ready, one at the end.
Otherwise it takes the options of `panoexec simulate`, except those of the camera.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import asdict

from panoexec.errors import PanoexecError
from panoexec.sim import settings
from panoexec.sim.config import SimConfig
from panoexec.sim.options import add_arguments, config_of
from panoexec.sim.run_documents import Ready


def main(argv: list[str]) -> int:
    """Run the simulation; an exit code of docs/contract.md."""
    stdin_bound = argv[:1] == ["--config-from-stdin"]
    try:
        config = settings.from_json(json.loads(_first_line())) if stdin_bound else _from_options(argv)
        return _run(config, stdin_bound=stdin_bound, paced=argv[1:] == ["--leashed"])
    except PanoexecError as error:
        print(f"panoexec: {' '.join(str(error).split())}", file=sys.stderr)
        return error.exit_code


def _first_line() -> bytes:
    """The first line of standard input, read byte by byte so that no later bytes get lost in a buffer."""
    line = b""
    while (byte := os.read(sys.stdin.fileno(), 1)) not in (b"", b"\n"):
        line += byte
    return line


def _from_options(argv: list[str]) -> SimConfig:
    parser = argparse.ArgumentParser(prog="python -m panoexec.sim", description=__doc__)
    add_arguments(parser)
    return config_of(parser.parse_args(argv))


def _run(config: SimConfig, *, stdin_bound: bool, paced: bool) -> int:
    from panoexec.sim.server import run_simulation  # noqa: PLC0415  (pymavlink may be missing)

    def ready(state: Ready) -> None:
        print(json.dumps(state.document()), flush=True)

    def note(text: str) -> None:
        print(f"simulation: {text}", file=sys.stderr, flush=True)

    summary = run_simulation(config, on_ready=ready, note=note, stdin_bound=stdin_bound, paced=paced)
    print(json.dumps(asdict(summary)), flush=True)
    return 130 if summary.interrupted else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
