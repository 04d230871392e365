"""What each of the daemon's small savings buys: the daemon with it beside the daemon without it, in one run.

Each daemon has a simulated vehicle of its own, whose gimbal and airframe report 50 times a second. They wait side by
side, so whatever disturbs one disturbs the others. In the second group no report is throttled: a daemon that captures
hears them all. Processor times are the scheduler's, in nanoseconds.
"""

from __future__ import annotations

import asyncio
import os
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Iterable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Final

from panoexec.sim.config import SimConfig
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.bench.bench_service import usage
from tests.bench.harness import Measurement
from tests.wire.broker import running_broker

WAIT_S: Final = float(os.environ.get("PANOEXEC_BENCH_SAVINGS_S", "10"))
_SETTLED_S: Final = 10.0
_LISTEN: Final = "from panoexec.adapters.link.message_hub import MessageHub; MessageHub.throttle = lambda *_: None; "
_LEAN: Final = "import panoexec.cli.lean; "
_WITHOUT: Final[Mapping[str, str]] = {
    "waiting": _LEAN,
    "bpf_filter": _LEAN
    + "from panoexec.adapters.link.bpf_filter import DatagramFilter; DatagramFilter.mute = lambda _: None",
    "lean": "import structlog",
    "listening": _LEAN + _LISTEN,
    "thread_state": _LEAN
    + _LISTEN
    + "import panoexec.adapters.link.message_hub as it; it.keep_thread_state = lambda: None",
    "one_heap": _LEAN + _LISTEN + "import panoexec.cli.one_heap as it; it.use_one_heap = lambda: False",
}
"""What is run before the daemon begins, to switch a saving off."""


def measure() -> Iterable[Measurement]:
    """All of them."""
    with tempfile.TemporaryDirectory() as folder:
        waiting = asyncio.run(_side_by_side(Path(folder), ("waiting", "bpf_filter", "lean")))
        listening = asyncio.run(_side_by_side(Path(folder), ("listening", "thread_state", "one_heap")))
    found = waiting | listening
    for name, what, unit, column, peer in (
        ("bpf_filter", "idle: processor", "% of a core", 0, "waiting"),
        ("thread_state", "every report heard: processor", "% of a core", 0, "listening"),
        ("one_heap", "every report heard: resident", "MB", 1, "listening"),
        ("lean", "idle: resident", "MB", 1, "waiting"),
    ):
        yield Measurement(
            what=what, ours=found[peer][column], unit=unit, peer=f"without {name}", theirs=found[name][column]
        )


async def _side_by_side(folder: Path, names: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Of each daemon: processor while it waits (% of a core), resident memory at the end (MB)."""
    async with AsyncExitStack() as stack:
        broker = stack.enter_context(running_broker(folder))
        daemons = {name: await stack.enter_async_context(_daemon(folder, name, broker.port)) for name in names}
        await asyncio.sleep(_SETTLED_S)
        before, began = {name: _processor_s(pid) for name, pid in daemons.items()}, time.monotonic()
        await asyncio.sleep(WAIT_S)
        lasted_s = time.monotonic() - began
        return {
            name: (
                100 * (_processor_s(pid) - before[name]) / lasted_s,
                usage(pid).resident_mb,
            )
            for name, pid in daemons.items()
        }


def _processor_s(pid: int) -> float:
    """Of all threads so far."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return sum(int((task / "schedstat").read_text().split()[0]) for task in tasks) / 1e9


@asynccontextmanager
async def _daemon(folder: Path, name: str, broker_port: int) -> AsyncIterator[int]:
    """The process of a daemon beside a simulated vehicle."""
    port = free_udp_port()
    config = folder / f"{name}.toml"
    config.write_text(
        f'[vehicle]\nid = "v{name}"\nconnection = "udpin://127.0.0.1:{port}"\n[mqtt]\nhost = "127.0.0.1"\n'
        f'port = {broker_port}\n[storage]\npath = "{folder}/{name}-data"\nmin_free_mb = 1\n'
    )
    program = f"{_WITHOUT[name]}\nimport sys\nfrom panoexec.__main__ import main\nsys.exit(main())"
    with (folder / f"{name}.log").open("ab") as log:
        async with running_simulator(SimConfig(port=port)):
            process = await asyncio.create_subprocess_exec(
                sys.executable, "-c", program, "serve", "--config", str(config), stdout=log, stderr=log
            )
            try:
                yield process.pid
            finally:
                if process.returncode is None:
                    process.terminate()
                await process.wait()
