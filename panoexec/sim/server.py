"""Runs the simulated vehicle: sockets, clock, renderer process, signals, orderly shutdown."""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import signal
import sys
from collections.abc import AsyncIterator, Callable
from typing import Any

from panoexec.errors import LinkError, UsageError
from panoexec.sim.config import DEFAULT_PORTS, SimConfig
from panoexec.sim.faults import AUTOPILOT_FAULTS
from panoexec.sim.mavlink.outlet import Outlet
from panoexec.sim.mavlink.wire import Message, TcpLink, UdpLink, attach
from panoexec.sim.pacing import TimeLimits
from panoexec.sim.photos.darkroom import Darkroom
from panoexec.sim.physics.following import AHEAD_S, SILENT_S, AutopilotTime
from panoexec.sim.physics.world import SimClock, TruthLog
from panoexec.sim.run_documents import Ready, Summary
from panoexec.sim.served_files import served_files
from panoexec.sim.simulation import Simulation
from panoexec.sim.tethered.ptpip import PtpIpServer

CAMERA_HOST = "127.0.0.1"
"""Where a tethered camera listens."""
_IDLE_S = 0.001
_DRAIN_S = 60.0
_BEHIND_S = 0.5
"""Lag in wall time that is reported to the user."""
_RECONNECT_S = 15.0
_SILENT_WAIT_S = 1.0
"""Wall time after which it reports that it waits for an autopilot."""
_CATCH_UP_S = 0.5
"""Budget of wall time for catching up with the autopilot's time; the rest follows with its next message."""


class Server:
    """One run of the simulation."""

    def __init__(
        self,
        config: SimConfig,
        *,
        on_ready: Callable[[Ready], None],
        note: Callable[[str], None],
        stdin_bound: bool = False,
        paced: bool = False,
    ) -> None:
        """Prepare a run.

        Args:
            config: the vehicle to simulate.
            on_ready: called once when the vehicle can be connected to.
            note: receives messages for display.
            stdin_bound: end at the end of standard input (when the parent ends).
            paced: with `stdin_bound`, limit simulated time as given on standard input (`panoexec.sim.pacing`).
        """
        self._config = config
        self._on_ready = on_ready
        self._note = note
        self._stdin_bound = stdin_bound
        self._limits = TimeLimits() if stdin_bound and paced else None
        self._autopilot = AutopilotTime() if config.attach_url is not None else None
        if self._autopilot is not None:
            self._limits = TimeLimits.long(config.speedup)
        self._stop = asyncio.Event()
        self._interrupted = False
        self._latest_s = 0.0
        self._link_lost = asyncio.Event()

    async def run(self) -> Summary:
        """Run until SIGINT, SIGTERM or, with `stdin_bound`, the end of standard input.

        Raises:
            UsageError: the output directory is not writable, or the scene or the URL to attach to is invalid.
            LinkError: the port is in use; no autopilot at the URL to attach to; the autopilot is gone.
        """
        config = self._config
        _check_faults(config)
        with self._signals():
            truth = _open_truth(config)
            try:
                link = await self._reach()
            except BaseException:
                truth.close()
                raise
            if link is None:
                truth.close()
                return Summary(
                    photos=0, written=0, failures=(), simulated_s=0.0, latest_s=0.0, interrupted=self._interrupted
                )
            outlet = Outlet(link, config.system_id)
            try:
                async with _darkroom(config) as darkroom, served_files(config) as served:
                    simulation = Simulation(
                        config,
                        clock=SimClock(config.speedup),
                        link=outlet,
                        truth=truth,
                        develop=darkroom.develop if darkroom else None,
                        file_url=served.file_url,
                        definition_uri=served.definition_uri,
                    )
                    async with self._tethered(simulation, darkroom) as camera_port:
                        return await self._serve(simulation, outlet, darkroom, camera_port)
            finally:
                outlet.link.close()
                truth.close()

    async def _reach(self) -> UdpLink | TcpLink | None:
        """Open the link, which may have to wait for an autopilot; None if stopped meanwhile."""
        opening = asyncio.create_task(_open_link(self._config), name="open the link")
        stopping = asyncio.create_task(self._stop.wait(), name="stop")
        try:
            await asyncio.wait({opening, stopping}, timeout=_SILENT_WAIT_S, return_when=asyncio.FIRST_COMPLETED)
            if not opening.done() and not stopping.done():
                self._note(f"waiting for an autopilot at {self._config.attach_url}")
                await asyncio.wait({opening, stopping}, return_when=asyncio.FIRST_COMPLETED)
            return await opening if opening.done() else None
        finally:
            opening.cancel()
            stopping.cancel()
            await asyncio.gather(opening, stopping, return_exceptions=True)

    @contextlib.asynccontextmanager
    async def _tethered(self, simulation: Simulation, darkroom: Darkroom | None) -> AsyncIterator[int]:
        """Serve the tethered camera; its port, 0 without one."""
        shutter = simulation.tethered
        if shutter is None or darkroom is None:
            yield 0
            return

        def arrived(_operation: int) -> None:
            # an operation is carried out at its time of arrival, not at the last advance
            if self._limits is None:
                simulation.advance(simulation.clock.now())

        server = PtpIpServer(shutter.responder, on_operation=arrived)
        port = await server.start(CAMERA_HOST, self._config.camera_port)

        def written(path: str) -> None:
            shutter.written(path)
            if self._limits is not None:
                self._limits.changed.set()  # simulated time may go on

        shutter.tell, darkroom.on_written = server.tell, written
        try:
            yield port
        finally:
            await server.stop()

    async def _serve(
        self, simulation: Simulation, outlet: Outlet, darkroom: Darkroom | None, camera_port: int
    ) -> Summary:
        self._use_link(outlet.link, simulation)
        simulation.start()
        self._on_ready(Ready(config=self._config, camera_port=camera_port))
        async with asyncio.TaskGroup() as tasks:
            developing = tasks.create_task(darkroom.run(), name="darkroom") if darkroom else None
            advance = self._advance_with_wall if self._limits is None else self._advance_paced
            turning = tasks.create_task(advance(simulation, outlet), name="simulation")
            linking = tasks.create_task(self._keep_link(simulation, outlet), name="link")
            await self._stop.wait()
            turning.cancel()
            linking.cancel()
            simulation.flush_photos()
            if darkroom is not None and developing is not None:
                await self._finish_photos(darkroom)
                developing.cancel()
        return Summary(
            photos=simulation.photos,
            written=darkroom.written if darkroom else 0,
            failures=tuple(darkroom.failures) if darkroom else (),
            simulated_s=simulation.timeline.now_s,
            latest_s=self._latest_s,
            interrupted=self._interrupted,
        )

    async def _finish_photos(self, darkroom: Darkroom) -> None:
        """Wait until the last photos are on disk; a second signal ends the wait."""
        self._stop.clear()
        if darkroom.pending:
            self._note(f"waiting for {darkroom.pending} photos to be written")
        waits = [
            asyncio.create_task(darkroom.drain(_DRAIN_S), name="drain"),
            asyncio.create_task(self._stop.wait(), name="second signal"),
        ]
        await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
        for wait in waits:
            wait.cancel()
        await asyncio.gather(*waits, return_exceptions=True)
        if darkroom.pending:
            self._note(f"{darkroom.pending} photos were not written")

    async def _advance_with_wall(self, simulation: Simulation, outlet: Outlet) -> None:
        """Advance simulated time with the wall clock."""
        clock, warned = simulation.clock, False
        while True:
            now = clock.now()
            simulation.advance(now)
            outlet.link.flush()
            late = -clock.wall_delay(simulation.next_s)
            self._latest_s = max(self._latest_s, late)
            if late > _BEHIND_S:
                clock.go_on(simulation.timeline.now_s, clock.speedup)
                if not warned:
                    warned = True
                    self._note(
                        f"this machine cannot keep up with speed-up {clock.speedup:g}: simulated time slows down"
                    )
            await asyncio.sleep(max(-late, _IDLE_S) if late < 0 else 0)

    async def _advance_paced(self, simulation: Simulation, outlet: Outlet) -> None:
        """Advance simulated time within the limits that the parent sets."""
        limits, clock, timeline = self._limits, simulation.clock, simulation.timeline
        assert limits is not None
        if self._autopilot is None:
            outlet.timeline = timeline
        while True:
            simulation.advance(min(clock.now(), limits.until_s, simulation.hold_s))
            outlet.tell_time()
            outlet.link.flush()
            until_s = min(limits.until_s, simulation.hold_s)
            held = timeline.now_s >= until_s
            wait_s: float | None = max(0.0, clock.wall_delay(min(simulation.next_s, until_s)))
            if held:
                wait_s = None if self._autopilot is None else SILENT_S
            if wait_s == 0:
                await asyncio.sleep(0)
            else:
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(wait_s):
                        await limits.changed.wait()
            if held and self._autopilot is not None and not limits.changed.is_set():
                self._autopilot.forget()
                limits.let(math.inf, self._config.speedup)
            if limits.changed.is_set():
                limits.changed.clear()
                if held or clock.speedup != limits.speed:
                    clock.go_on(timeline.now_s, limits.speed)

    def _use_link(self, link: UdpLink | TcpLink, simulation: Simulation) -> None:
        def receive(message: Message, frame: bytes) -> None:
            # process the message at its time of arrival, not at the last advance
            if self._autopilot is not None and message.get_type() == "AUTOPILOT_STATE_FOR_GIMBAL_DEVICE":
                self._follow_autopilot(simulation, message.time_boot_us)
            elif self._limits is None:
                simulation.advance(simulation.clock.now())
            simulation.receiver(message, frame)
            if isinstance(link, UdpLink) and simulation.forwards(message):
                link.forward(frame)
            link.flush()

        link.receiver = receive
        if isinstance(link, TcpLink):
            link.on_closed = self._link_lost.set

    def _follow_autopilot(self, simulation: Simulation, boot_us: int) -> None:
        """Advance to the autopilot's time and continue from there."""
        assert self._autopilot is not None
        assert self._limits is not None
        told_s = self._autopilot.at(boot_us, simulation.timeline.now_s)
        if told_s > simulation.timeline.now_s:
            simulation.advance(told_s, budget_s=_CATCH_UP_S)
            simulation.clock.go_on(told_s, self._config.speedup)
        self._limits.let(told_s + AHEAD_S, self._config.speedup)

    async def _keep_link(self, simulation: Simulation, outlet: Outlet) -> None:
        """Reconnect to an autopilot that closed the connection (reboot); only TCP detects it.

        Raises:
            LinkError: reconnecting failed.
        """
        while True:
            await self._link_lost.wait()
            self._link_lost.clear()
            self._note("the autopilot closed the connection; reconnecting")
            url = self._config.attach_url
            assert url is not None
            outlet.link = await attach(url, patience_s=_RECONNECT_S)
            self._use_link(outlet.link, simulation)

    @contextlib.contextmanager
    def _signals(self) -> Any:
        loop = asyncio.get_running_loop()

        def interrupted() -> None:
            self._interrupted = True
            self._stop.set()

        loop.add_signal_handler(signal.SIGINT, interrupted)
        loop.add_signal_handler(signal.SIGTERM, self._stop.set)
        if self._stdin_bound:
            loop.add_reader(sys.stdin.fileno(), self._stdin)
        try:
            yield
        finally:
            if self._stdin_bound:
                loop.remove_reader(sys.stdin.fileno())
            loop.remove_signal_handler(signal.SIGINT)
            loop.remove_signal_handler(signal.SIGTERM)

    def _stdin(self) -> None:
        data = os.read(sys.stdin.fileno(), 4096)
        if data and self._limits is not None:
            self._limits.feed(data)
        elif not data:
            asyncio.get_running_loop().remove_reader(sys.stdin.fileno())
            self._stop.set()


def _check_faults(config: SimConfig) -> None:
    if config.attach_url is None:
        return
    for spec in config.faults:
        if spec.name in AUTOPILOT_FAULTS:
            raise UsageError(
                f"--fault {spec.name} belongs to the autopilot, which is a real one with --attach; "
                "only faults of the payload are available"
            )


def _open_truth(config: SimConfig) -> TruthLog:
    if config.output is None:
        return TruthLog(None)
    try:
        config.output.mkdir(parents=True, exist_ok=True)
        return TruthLog(config.output / "truth.jsonl")
    except OSError as error:
        raise UsageError(f"--output {config.output}: not writable ({error.strerror}); give a directory") from error


@contextlib.asynccontextmanager
async def _darkroom(config: SimConfig) -> AsyncIterator[Darkroom | None]:
    """The renderer process, if photos are written."""
    if config.output is None:
        if config.camera_link == "gphoto2":
            raise UsageError("--camera-link gphoto2 needs --output: without a directory there are no photos")
        if config.scene is not None:
            raise UsageError("--scene needs --output: without a directory no photos are written")
        yield None
        return
    camera = config.camera
    darkroom = Darkroom(
        camera.optics,
        camera.render_width_px,
        scene=config.scene,
        seed=config.seed,
        scene_kind=config.scene_kind,
        file_kb=camera.file_kb,
    )
    # the exposure is metered by the first photo, for which the mission waits a bounded time
    await darkroom.start(wait=config.camera_link == "gphoto2" or camera.definition != "none")
    try:
        yield darkroom
    finally:
        await darkroom.close()


async def _open_link(config: SimConfig) -> UdpLink | TcpLink:
    if config.attach_url is not None:
        return await attach(config.attach_url)
    if config.listen:
        return UdpLink.waiting_on("ground", config.host, config.port or DEFAULT_PORTS[0])
    return UdpLink.sending_to("ground", config.host, [config.port] if config.port else DEFAULT_PORTS)


def run_simulation(
    config: SimConfig,
    *,
    on_ready: Callable[[Ready], None],
    note: Callable[[str], None],
    stdin_bound: bool = False,
    paced: bool = False,
) -> Summary:
    """Run the simulated vehicle in the foreground until it is stopped; see `Server`.

    Raises:
        PanoexecError: see `Server.run`.
    """
    try:
        return asyncio.run(Server(config, on_ready=on_ready, note=note, stdin_bound=stdin_bound, paced=paced).run())
    except BaseExceptionGroup as group:
        # one of the tasks failed with an error for the user
        understood, _ = group.split(LinkError)
        if understood is not None:
            raise understood.exceptions[0] from group
        raise
