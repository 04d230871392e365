"""Starts and stops the simulated vehicle as a child process; does not import pymavlink itself."""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from typing import Any

from panoexec.errors import DeviceError, LinkError, PanoexecError, UsageError
from panoexec.sim import settings
from panoexec.sim.config import SimConfig
from panoexec.sim.pacing import limits_line

_START_S = 60.0
_STOP_S = 75.0
_HURRIED_S = 0.5
"""Time for the last photos after an interrupt or a failure."""
_HURRIED_STOP_S = 3.0
_ERRORS: dict[int, type[PanoexecError]] = {2: UsageError, 3: LinkError}


@dataclass(slots=True)
class SimulatorProcess:
    """A running simulation.

    Attributes:
        config: the simulated vehicle.
        ready: its ready message (`panoexec.sim.server.Ready.document`).
        summary: its final message (`panoexec.sim.server.Summary` as a document); empty before the end.
    """

    config: SimConfig
    ready: dict[str, Any]
    process: asyncio.subprocess.Process
    summary: dict[str, Any] = field(default_factory=dict)

    def allow(self, until_s: float, speed: float) -> None:
        """Let simulated time advance, if the simulation is paced.

        Args:
            until_s: up to this moment (it may have advanced further already).
            speed: maximum simulated seconds per second.
        """
        assert self.process.stdin is not None
        if not self.process.stdin.is_closing():
            self.process.stdin.write(limits_line(until_s, speed))

    async def wait(self) -> int:
        """Wait until it exits by itself, which it does only after an error; return its exit code."""
        return await self.process.wait()

    async def stop(self, *, hurried: bool = False) -> None:
        """Stop it and let it write its last photos; kill it after a timeout. May be called twice.

        Args:
            hurried: photos that are not written soon are discarded; none is left half-written.
        """
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        timer = asyncio.get_running_loop().call_later(_HURRIED_S, self._end_waiting) if hurried else None
        try:
            async with asyncio.timeout(_HURRIED_STOP_S if hurried else _STOP_S):
                rest = await self.process.stdout.read()
                await self.process.wait()
        except TimeoutError:
            self.process.kill()
            await self.process.wait()
            return
        finally:
            if timer is not None:
                timer.cancel()
        for line in rest.splitlines():
            with contextlib.suppress(json.JSONDecodeError):
                self.summary = json.loads(line)

    def _end_waiting(self) -> None:
        """SIGTERM, after the end of its input, ends its wait for the last photos."""
        with contextlib.suppress(ProcessLookupError):
            self.process.terminate()


async def _spawn(config: SimConfig, *, paced: bool) -> asyncio.subprocess.Process:
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "panoexec.sim",
        "--config-from-stdin",
        *(["--leashed"] if paced else []),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        # the parent handles Ctrl-C: it ends the mission first and the vehicle after it
        start_new_session=True,
    )
    assert process.stdin is not None
    process.stdin.write(json.dumps(settings.to_json(config)).encode() + b"\n")
    return process


@contextlib.asynccontextmanager
async def running_simulator(
    config: SimConfig, *, note: Callable[[str], None] = lambda _: None, paced: bool = False
) -> AsyncIterator[SimulatorProcess]:
    """A simulated vehicle while the block runs.

    Args:
        config: the vehicle to simulate.
        note: receives messages of the simulation for display, line by line.
        paced: simulated time does not advance until `SimulatorProcess.allow`.

    Raises:
        UsageError: the configuration is invalid (scene not an image, output not writable), or pymavlink is missing;
            the message is the simulation's own.
        LinkError: a port is in use, or there is no autopilot to attach to.
        DeviceError: it did not start.
    """
    process = await _spawn(config, paced=paced)
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
        except BaseException:
            await simulator.stop(hurried=True)
            raise
        await simulator.stop()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
        errors.cancel()
        await asyncio.gather(errors, return_exceptions=True)


async def _last_line(stream: asyncio.StreamReader, note: Callable[[str], None]) -> str:
    """Forward the child's standard error; return its last line."""
    last = ""
    while line := await stream.readline():
        last = line.decode(errors="replace").rstrip()
        if last.startswith("simulation: "):
            note(last.removeprefix("simulation: "))
    return last
