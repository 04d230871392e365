"""An autopilot in software (SITL) as a child process: started, monitored, and killed together with its parent."""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Final

from panoexec.dryrun import arducopter, px4, sweeper, tether
from panoexec.dryrun.firmware import Firmware, Launch, SitlOptions
from panoexec.errors import DeviceError, UsageError

BINARY_VARIABLES: Final = (arducopter.BINARY_VARIABLE, px4.BINARY_VARIABLE)
"""Environment variables with the path of a binary, in the order in which `--sitl` without a value looks at them."""

_LOG = "sitl.log"
_TERM_S = 3.0
_WHAT = f"{arducopter.WHAT}, or {px4.WHAT}"


def sitl_binary(named: str | None) -> Path:
    """The binary given by the user or by the environment.

    Args:
        named: value of `--sitl`; None or "" selects the environment variables.

    Raises:
        UsageError: there is none, or it is not executable.
    """
    source, text = "--sitl", named or ""
    if not text:
        source, text = next(((name, value) for name in BINARY_VARIABLES if (value := os.environ.get(name))), ("", ""))
    if not text:
        variables = " or ".join(BINARY_VARIABLES)
        raise UsageError(f"--sitl: no binary given; name {_WHAT}, here or in the environment as {variables}")
    path = Path(text).expanduser()
    if not path.exists():
        problem = "no such file"
    elif not path.is_file():
        problem = "not a file"
    elif path.suffix == ".py":
        problem = "a script, not a binary"
    elif not os.access(path, os.X_OK):
        problem = "not executable"
    else:
        return path.absolute()
    raise UsageError(f"{source} {text}: {problem}; expected {_WHAT}")


def firmware_of(binary: Path) -> Firmware:
    """The autopilot that a binary is."""
    return px4.Px4() if px4.is_px4(binary) else arducopter.ArduCopter()


class SitlProcess:
    """A running SITL."""

    def __init__(self, process: asyncio.subprocess.Process, options: SitlOptions, folder: Path) -> None:
        self._process = process
        self._options = options
        self._folder = folder

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def last_output(self) -> str:
        """The last line of its output; "" if none."""
        with contextlib.suppress(OSError):
            text = (self._folder / _LOG).read_text(encoding="utf-8", errors="replace")
            for line in reversed(text.splitlines()):
                if line.strip():
                    return line.strip()
        return ""

    async def watch(self) -> None:
        """Wait until the process exits, and raise.

        Raises:
            UsageError: the binary cannot run on this machine.
            DeviceError: it exited; with its last output line.
        """
        code = await self._process.wait()
        words = self.last_output
        if code == tether.CANNOT_RUN and words.startswith(str(self._options.binary)):
            reason = words.removeprefix(str(self._options.binary)).lstrip(": ")
            raise UsageError(f"--sitl {self._options.binary}: cannot be executed ({reason}); expected {_WHAT}")
        how = f"exit code {code}" if code >= 0 else f"signal {-code}"
        said = f"; last output: {words}" if words else ", without output"
        raise DeviceError(f"the SITL {self._options.binary} exited unexpectedly ({how}){said}")

    async def stop(self) -> None:
        """Terminate it; kill it after a timeout."""
        for end in (signal.SIGTERM, signal.SIGKILL):
            if self._process.returncode is not None:
                return
            with contextlib.suppress(ProcessLookupError):
                # the whole group: PX4 starts its modules from a shell
                os.killpg(self._process.pid, end)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_TERM_S):
                    await self._process.wait()


@contextlib.asynccontextmanager
async def running_sitl(options: SitlOptions) -> AsyncIterator[SitlProcess]:
    """An autopilot in SITL, in its own temporary directory, while the block runs."""
    with tempfile.TemporaryDirectory(prefix="panoexec-sitl-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        launch = firmware_of(options.binary).launch(folder, options)
        async with _swept(folder, *launch.leaves):
            try:
                async with _started(launch, options, folder) as sitl:
                    yield sitl
            finally:
                for path in launch.leaves:
                    path.unlink(missing_ok=True)
                await asyncio.to_thread(shutil.rmtree, folder, ignore_errors=True)


@contextlib.asynccontextmanager
async def _swept(*paths: Path) -> AsyncIterator[None]:
    """Another process that removes these paths if this one is killed while the block runs."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-I", "-S", sweeper.__file__),
        *map(str, paths),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        yield
    finally:
        assert process.stdin is not None
        process.stdin.close()
        await asyncio.shield(process.wait())


@contextlib.asynccontextmanager
async def _started(launch: Launch, options: SitlOptions, folder: Path) -> AsyncIterator[SitlProcess]:
    with (folder / _LOG).open("wb") as log:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-I", "-S", tether.__file__, str(os.getpid())),
            *launch.command,
            cwd=folder,
            env=os.environ | launch.environment,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=log,
            stderr=asyncio.subprocess.STDOUT,
            # the parent handles Ctrl-C: it ends the mission first and the vehicle after it
            start_new_session=True,
        )
    sitl = SitlProcess(process, options, folder)
    try:
        yield sitl
    finally:
        await asyncio.shield(sitl.stop())
