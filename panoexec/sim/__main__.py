"""`python -m panoexec.sim`: the simulated vehicle as a process."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m panoexec.sim")
    parser.add_argument("--port", type=int, default=14550)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--speedup", type=float, default=1.0)
    parser.add_argument("--attach")
    args = parser.parse_args()
    from panoexec.sim.config import SimConfig
    from panoexec.sim.server import run_simulation
    if args.output: args.output.mkdir(parents=True, exist_ok=True)
    return run_simulation(SimConfig(port=args.port, output=args.output, seed=args.seed, speedup=args.speedup, attach_url=args.attach), announce_json=True)


if __name__ == "__main__":
    sys.exit(main())
