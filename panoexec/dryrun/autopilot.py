"""An ArduCopter SITL as a child process: started, monitored, and killed together with its parent."""

from __future__ import annotations

import asyncio
import contextlib
import importlib.resources
import os
import socket
import sys
import tempfile
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from panoexec.dryrun import tether
from panoexec.errors import DeviceError, UsageError

BINARY_VARIABLE = "ARDUPILOT_SITL"
"""Environment variable with the path of the binary."""

PARAMETER_FILE = "ardupilot-sitl.parm"
_LOG = "sitl.log"
_TERM_S = 3.0
_WHAT = "the ArduCopter binary of an ArduPilot SITL build, build/sitl/bin/arducopter"


@dataclass(frozen=True, slots=True, kw_only=True)
class SitlOptions:
    """How to start the SITL.

    Attributes:
        binary: ArduCopter, built for SITL.
        ground_port: UDP port on this machine that SERIAL0 sends to, for the ground station.
        payload_port: UDP port on this machine that SERIAL1 sends to, for the payload.
        speedup: simulated seconds per second.
        home: latitude and longitude in degrees, altitude above mean sea level in metres, heading in degrees.
        parameters: autopilot parameters in addition to the parameter file.
    """

    binary: Path
    ground_port: int
    payload_port: int
    speedup: float
    home: tuple[float, float, float, float]
    parameters: Mapping[str, float]


def sitl_binary(named: str | None) -> Path:
    """The binary given by the user or by the environment.

    Args:
        named: value of `--sitl`; None or "" selects the environment variable.

    Raises:
        UsageError: there is none, or it is not executable.
    """
    text = named or os.environ.get(BINARY_VARIABLE, "")
    if not text:
        raise UsageError(f"--sitl: no binary given; name {_WHAT}, here or in the environment as {BINARY_VARIABLE}")
    path, source = Path(text).expanduser(), "--sitl" if named else BINARY_VARIABLE
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


def free_udp_ports(count: int) -> list[int]:
    """Different UDP ports that are currently unused."""
    with contextlib.ExitStack() as stack:
        probes = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(count)]
        for probe in probes:
            probe.bind(("127.0.0.1", 0))
        return [int(probe.getsockname()[1]) for probe in probes]


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
        for end in (self._process.terminate, self._process.kill):
            if self._process.returncode is not None:
                return
            with contextlib.suppress(ProcessLookupError):
                end()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_TERM_S):
                    await self._process.wait()


@contextlib.asynccontextmanager
async def running_sitl(options: SitlOptions) -> AsyncIterator[SitlProcess]:
    """ArduCopter in SITL, in its own temporary directory, while the block runs."""
    with tempfile.TemporaryDirectory(prefix="panoexec-sitl-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        command = _command(options, defaults=_write_parameters(folder, options.parameters))
        with (folder / _LOG).open("wb") as log:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-I", "-S", tether.__file__, str(os.getpid())),
                *command,
                cwd=folder,
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


def _write_parameters(folder: Path, parameters: Mapping[str, float]) -> str:
    """The parameter files, in order of increasing precedence."""
    shipped, added = folder / PARAMETER_FILE, folder / "run.parm"
    text = (importlib.resources.files("panoexec.dryrun") / PARAMETER_FILE).read_text(encoding="utf-8")
    shipped.write_text(text, encoding="utf-8")
    added.write_text("".join(f"{name} {value:g}\n" for name, value in parameters.items()), encoding="utf-8")
    return f"{shipped.name},{added.name}"


def _command(options: SitlOptions, *, defaults: str) -> list[str]:
    rc_port, irlock_port = free_udp_ports(2)
    latitude_deg, longitude_deg, altitude_m, heading_deg = options.home
    return [
        str(options.binary),
        *("--model", "+"),
        "--wipe",
        *("--speedup", f"{options.speedup:g}"),
        *("--home", f"{latitude_deg:.7f},{longitude_deg:.7f},{altitude_m:.2f},{heading_deg:.1f}"),
        *("--defaults", defaults),
        *("--serial0", f"udpclient:127.0.0.1:{options.ground_port}"),
        *("--serial1", f"udpclient:127.0.0.1:{options.payload_port}"),
        *("--serial2", "none"),
        # it binds these ports whether they are used or not
        *("--rc-in-port", str(rc_port)),
        *("--irlock-port", str(irlock_port)),
    ]
