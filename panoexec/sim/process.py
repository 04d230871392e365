"""Starts the simulated vehicle as a child process and stops it again; needs neither pymavlink nor Pillow itself."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import sys
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from typing import Any

from panoexec.errors import DeviceError, LinkError, PanoexecError, UsageError
from panoexec.sim import settings
from panoexec.sim.config import SimConfig
from panoexec.sim.pacing import allowance_line

_START_S = 60.0
_STOP_S = 75.0
_ERRORS: dict[int, type[PanoexecError]] = {2: UsageError, 3: LinkError}


def free_udp_port() -> int:
    """A UDP port that nobody listens on at the moment."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass(slots=True)
class SimulatorProcess:
    """A running simulation.

    Attributes:
        config: what it simulates.
        ready: what it said when it was ready (`panoexec.sim.server.Ready.document`).
        summary: what it said at its end (`panoexec.sim.server.Summary` as a document); empty before.
    """

    config: SimConfig
    ready: dict[str, Any]
    process: asyncio.subprocess.Process
    summary: dict[str, Any] = field(default_factory=dict)

    def allow(self, until_s: float, speed: float) -> None:
        """Let simulated time go on, if it is on a leash.

        Args:
            until_s: to this moment (it may have gone further already).
            speed: simulated seconds a second at most.
        """
        assert self.process.stdin is not None
        if not self.process.stdin.is_closing():
            self.process.stdin.write(allowance_line(until_s, speed))

    async def wait(self) -> int:
        """Wait until it ends by itself, which only an error makes it do; its exit code."""
        return await self.process.wait()

    async def stop(self) -> None:
        """End it and let it write its last photos; kill it if it takes too long. Twice does no harm."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        try:
            async with asyncio.timeout(_STOP_S):
                rest = await self.process.stdout.read()
                await self.process.wait()
        except TimeoutError:
            self.process.kill()
            await self.process.wait()
            return
        for line in rest.splitlines():
            with contextlib.suppress(json.JSONDecodeError):
                self.summary = json.loads(line)


async def _spawn(config: SimConfig, *, leashed: bool) -> asyncio.subprocess.Process:
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "panoexec.sim",
        "--config-from-stdin",
        *(["--leashed"] if leashed else []),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        # Ctrl-C is the parent's: it ends the mission first and the vehicle after it
        start_new_session=True,
    )
    assert process.stdin is not None
    process.stdin.write(json.dumps(settings.to_json(config)).encode() + b"\n")
    return process


@contextlib.asynccontextmanager
async def running_simulator(
    config: SimConfig, *, note: Callable[[str], None] = lambda _: None, leashed: bool = False
) -> AsyncIterator[SimulatorProcess]:
    """A simulated vehicle while the block runs.

    Args:
        config: what to simulate.
        note: takes what the simulation has to say to people, line by line.
        leashed: its time stands still until `SimulatorProcess.allow`.

    Raises:
        UsageError: the configuration is wrong (the scene is none, the output cannot be written), or pymavlink or
            Pillow is missing; the message is the simulation's own.
        LinkError: a port in use, or nobody to attach to.
        DeviceError: it did not start.
    """
    process = await _spawn(config, leashed=leashed)
    assert process.stdout is not None
    assert process.stderr is not None
    errors = asyncio.create_task(_last_line(process.stderr, note), name="simulator stderr")
    try:
        try:
            async with asyncio.timeout(_START_S):
                line = await process.stdout.readline()
        except TimeoutError:
            process.kill()
            line = b""
        if not line:
            code = await process.wait()
            text = (await errors).removeprefix("panoexec: ") or "the simulated vehicle did not start"
            raise _ERRORS.get(code, DeviceError)(text)
        simulator = SimulatorProcess(config, json.loads(line), process)
        try:
            yield simulator
        finally:
            await simulator.stop()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
        errors.cancel()
        await asyncio.gather(errors, return_exceptions=True)


async def _last_line(stream: asyncio.StreamReader, note: Callable[[str], None]) -> str:
    """Pass on what the child says on its standard error; its last line."""
    last = ""
    while line := await stream.readline():
        last = line.decode(errors="replace").rstrip()
        if last.startswith("simulation: "):
            note(last.removeprefix("simulation: "))
    return last
