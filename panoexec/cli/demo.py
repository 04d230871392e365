"""Show it all on this computer: broker, simulated vehicle, daemon and the operator's page, until Ctrl-C.

Everything runs as in the field, each program in a process of its own; only the vehicle is simulated. The missions stay
in the output folder.

Examples:
  panoexec demo
  panoexec demo --speedup 4 --fault photo-blur=2
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import getpass
import importlib.util
import os
import shutil
import signal
import socket
import sys
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from panoexec.cli.numbers import positive
from panoexec.cli.output import note
from panoexec.dryrun import tether
from panoexec.errors import DependencyError, DeviceError, LinkError, UsageError, to_install
from panoexec.files import write_atomically
from panoexec.inputs.service_sections import MqttSection
from panoexec.sim.ports import free_tcp_port, free_udp_port

EXIT_INTERRUPTED: Final = 130
VEHICLE: Final = "demo"
_PAGE_PORT: Final = 8090
_READY_S: Final = 60.0
_STOP_S: Final = 10.0
_BROKER: Final = """\
listener {port} 127.0.0.1
allow_anonymous true
# started by root it would change its user, and with that forget to end with its parent
user {user}
"""
_MOSQUITTO: Final = ("mosquitto", "/usr/sbin/mosquitto", "/usr/local/sbin/mosquitto")
_BATTERY_MINUTES: Final = 1_000_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument(
        "--page-port", type=int, default=None, metavar="PORT", help="of the page (8090, else a free one; 0: a free one)"
    )
    parser.add_argument(
        "--output", type=Path, default=Path("demo"), metavar="DIR", help="missions, photos, logs (demo)"
    )
    parser.add_argument("--camera", default="dji-x5s-15mm", metavar="NAME", help="camera profile (dji-x5s-15mm)")
    parser.add_argument("--speedup", type=positive, default=1.0, metavar="N", help="how fast simulated time passes (1)")
    parser.add_argument("--wind", metavar="M_S", help="of the simulated vehicle, see `panoexec simulate`")
    parser.add_argument("--fault", action="append", default=[], metavar="FAULT", help="see `panoexec simulate`")


def run(args: argparse.Namespace) -> int:
    """Run until Ctrl-C, or until one of the programs ends."""
    for package in ("mavsdk", "pymavlink"):
        if importlib.util.find_spec(package) is None:
            raise DependencyError(f"`demo` needs the Python package {package}: {to_install('sim')}")
    broker = next(filter(None, map(shutil.which, _MOSQUITTO)), None)
    if broker is None:
        raise UsageError("`demo` needs the MQTT broker mosquitto: apt install mosquitto")
    return asyncio.run(_demo(args, broker))


@dataclass(slots=True)
class _Programs:
    """The running programs, in the order of their start."""

    folder: Path
    running: dict[str, asyncio.subprocess.Process] = field(default_factory=dict)

    async def start(self, name: str, command: Sequence[str]) -> None:
        """Start one; the kernel ends it if this process is killed."""
        with self._log(name).open("wb") as log:
            self.running[name] = await asyncio.create_subprocess_exec(
                *(sys.executable, "-I", "-S", tether.__file__, str(os.getpid()), *command),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,  # Ctrl-C is for this process, which ends the others in order
            )

    async def panoexec(self, name: str, *arguments: str) -> None:
        """Start a panoexec of its own."""
        await self.start(name, [sys.executable, "-m", "panoexec", *arguments])

    async def watch(self) -> None:
        """Return when one has ended.

        Raises:
            DeviceError: always, with its name and its last words.
        """
        waits = {asyncio.create_task(one.wait(), name=name): name for name, one in self.running.items()}
        try:
            done, _ = await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for wait in waits:
                wait.cancel()
        name = waits[done.pop()]
        lines = self._log(name).read_text(encoding="utf-8", errors="replace").split("\n")
        last = next((line for line in reversed(lines) if line.strip()), "without output")
        raise DeviceError(f"{name} has ended ({last.strip()[:300]}); its log is {self._log(name)}")

    async def stop(self) -> None:
        """End them, the last one first."""
        for one in reversed(self.running.values()):
            for end in (signal.SIGTERM, signal.SIGKILL):
                if one.returncode is None:
                    with contextlib.suppress(ProcessLookupError):
                        one.send_signal(end)
                    with contextlib.suppress(TimeoutError):
                        async with asyncio.timeout(_STOP_S):
                            await one.wait()

    def _log(self, name: str) -> Path:
        return self.folder / f"{name}.log"


async def _demo(args: argparse.Namespace, broker: str) -> int:
    loop, over = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, over.set)
    folder = _made(args.output)
    async with _running(args, broker, folder) as (programs, mqtt_port, page_port):
        watch = asyncio.create_task(programs.watch(), name="programs")
        interrupted = asyncio.create_task(over.wait(), name="signal")
        ready = asyncio.create_task(_ready(mqtt_port, page_port), name="ready")
        try:
            done, _ = await asyncio.wait({watch, interrupted, ready}, return_when=asyncio.FIRST_COMPLETED)
            if done == {ready} and ready.exception() is None:
                _tell(folder, mqtt_port, page_port)
                done, _ = await asyncio.wait({watch, interrupted}, return_when=asyncio.FIRST_COMPLETED)
            if interrupted not in done:
                for task in done:
                    task.result()  # raises what ended it
        finally:
            for task in (watch, interrupted, ready):
                task.cancel()
            await asyncio.gather(watch, interrupted, ready, return_exceptions=True)
    note(f"ended; the missions are in {folder / 'flown' / 'missions'}")
    return EXIT_INTERRUPTED


@contextlib.asynccontextmanager
async def _running(args: argparse.Namespace, broker: str, folder: Path) -> AsyncIterator[tuple[_Programs, int, int]]:
    mqtt_port, vehicle_port = free_tcp_port(), free_udp_port()
    page_port = _page_port(args.page_port)
    config = folder / "config.toml"
    write_atomically(config, _configuration(args.camera, folder, mqtt_port, vehicle_port))
    broker_file = folder / "mosquitto.conf"
    write_atomically(broker_file, _BROKER.format(port=mqtt_port, user=getpass.getuser()))
    simulate = ["--port", str(vehicle_port), "--output", str(folder / "photos"), "--camera", args.camera]
    simulate += ["--speedup", str(args.speedup), *(["--wind", args.wind] if args.wind else [])]
    simulate += [word for fault in args.fault for word in ("--fault", fault)]
    # it hovers until Ctrl-C: with a battery as it is, missions would be refused after a quarter of an hour
    simulate += ["--set", f"airframe.battery_minutes={_BATTERY_MINUTES}"]
    programs = _Programs(folder)
    try:
        note("starting broker, simulated vehicle, daemon and page …")
        await programs.start("broker", [broker, "-c", str(broker_file)])
        await programs.panoexec("vehicle", "simulate", *simulate)
        await programs.panoexec("daemon", "serve", "--config", str(config), "--speedup", str(args.speedup))
        await programs.panoexec("page", "web", "--config", str(config), "--listen", f"127.0.0.1:{page_port}")
        yield programs, mqtt_port, page_port
    finally:
        await programs.stop()


def _configuration(camera: str, folder: Path, mqtt_port: int, vehicle_port: int) -> str:
    return f"""\
[vehicle]
id = "{VEHICLE}"
connection = "udpin://127.0.0.1:{vehicle_port}"
[camera]
profile = "{camera}"
file_folders = ["{folder}/photos"]
[mqtt]
host = "127.0.0.1"
port = {mqtt_port}
[storage]
path = "{folder}/flown"
[presets.around]
name = "All around, ground to horizon"
elevation_deg = [-90, 30]
[presets.front]
name = "What is in front"
elevation_deg = [-40, 10]
azimuth_deg = [-60, 60]
"""


async def _ready(mqtt_port: int, page_port: int) -> None:
    """Return when the page answers and the daemon has found vehicle, gimbal and camera.

    Raises:
        LinkError: not in time; the message says what is missing.
    """
    from panoexec.mqtt.ground_station import GroundStation  # noqa: PLC0415

    lacking = "the broker does not answer"
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(_READY_S):
            while True:
                try:
                    _, writer = await asyncio.open_connection("127.0.0.1", page_port)
                    writer.close()
                    async with GroundStation(MqttSection(host="127.0.0.1", port=mqtt_port)) as ground:
                        answer = await ground.request(VEHICLE, "get", {}, timeout_s=5.0)
                    links = answer["data"]["link"]
                    missing = [name for name in ("autopilot", "gimbal", "camera") if not links[name]["ok"]]
                    if not missing:
                        return
                    lacking = f"the daemon has not found {', '.join(missing)}"
                except (OSError, LinkError) as error:
                    lacking = str(error)
                await asyncio.sleep(0.3)
    raise LinkError(f"not ready after {_READY_S:g} s: {lacking}")


def _tell(folder: Path, mqtt_port: int, page_port: int) -> None:
    where = f"--host 127.0.0.1 --port {mqtt_port} --vehicle {VEHICLE}"
    note(
        f"""a simulated drone hovers at 30 m and waits for its panorama

  page      http://127.0.0.1:{page_port}/v/{VEHICLE}
  missions  {folder / "flown" / "missions"}

or from another terminal:
  panoexec start --preset front {where}
  panoexec watch {where}

Ctrl-C ends everything."""
    )


def _made(output: Path) -> Path:
    try:
        for name in ("photos", "flown"):
            (output / name).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"--output {output}: cannot be used ({error.strerror})") from error
    return output.resolve()


def _page_port(asked: int | None) -> int:
    """The port for the page: the one that was asked for, else 8090, else a free one."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", _PAGE_PORT if asked is None else asked))
        except (OSError, OverflowError) as error:
            if asked is not None:
                raise UsageError(f"--page-port {asked}: cannot be used ({error})") from error
            return free_tcp_port()
    return _PAGE_PORT if asked is None else asked or free_tcp_port()
