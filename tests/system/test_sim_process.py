"""The simulated vehicle as a process: how it starts, what it says, how it ends, what it leaves behind."""

from __future__ import annotations

import asyncio
import itertools
import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from panoexec.cli.app import run
from panoexec.errors import LinkError, UsageError
from panoexec.sim.config import SimConfig
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.mavlink.wire import UdpLink, attach
from panoexec.sim.pacing import TIME_COMPONENT, TIME_MESSAGE, time_from_fields
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.waiting import wait_until
from tests.wire.sim_peer import EmbeddedPeer

SIMULATE = [sys.executable, "-m", "panoexec", "simulate"]


def simulate(*options: str, timeout_s: float = 90.0) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*SIMULATE, *options], capture_output=True, text=True, timeout=timeout_s, check=False)


@pytest.fixture
def ground() -> Iterator[socket.socket]:
    """A ground station's UDP socket."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(60)
        yield sock


def port_of(sock: socket.socket) -> str:
    return str(sock.getsockname()[1])


@pytest.mark.parametrize(("stop", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 0)])
def test_the_verb_says_how_to_connect_flies_and_ends_cleanly(
    ground: socket.socket, tmp_path: Path, stop: signal.Signals, code: int
) -> None:
    photos = ["--output", str(tmp_path / "photos"), "--camera", "dji-x5s-15mm", "--image-width", "160"]
    options = ["--port", port_of(ground), *photos, "--json"]
    with subprocess.Popen([*SIMULATE, *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        data, vehicle = ground.recvfrom(65535)
        assert mavlink.MAVLink(None).decode(bytearray(data[: 12 + data[1]])).get_type() == "HEARTBEAT"
        shoot = mavlink.MAVLink_command_long_message(
            1, 100, mavlink.MAV_CMD_IMAGE_START_CAPTURE, 0, 0, 0, 1, 1, 0, 0, 0
        )
        ground.sendto(shoot.pack(mavlink.MAVLink(None, 1, 195)), vehicle)
        wait_until((tmp_path / "photos" / "IMG_00001.jpg").exists)
        children = children_of(process.pid)
        assert children
        process.send_signal(stop)
        out, err = process.communicate(timeout=90)
    assert process.returncode == code
    document = json.loads(out)
    assert document["connect"] == f"udpin://0.0.0.0:{port_of(ground)}"
    assert document["connect"] in err
    assert "1 of 1 photos written" in err
    assert "Traceback" not in err
    assert not any(alive(pid) for pid in children)
    events = [
        json.loads(line) for line in (tmp_path / "photos" / "truth.jsonl").read_text(encoding="utf-8").splitlines()
    ]
    assert [event["event"] for event in events] == ["start", "exposure"]
    assert not list((tmp_path / "photos").glob(".*"))


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--fault", "gimbal-broken"], "unknown fault 'gimbal-broken'; known are attitude-frozen"),
        (["--speedup", "0"], "--speedup 0: expected more than 0"),
        (["--speedup", "fast"], "--speedup"),
        (["--port", "99999"], "--port 99999: expected 1 to 65535"),
        (["--camera", "no-such-camera"], "no camera profile 'no-such-camera'"),
        (["--attach", "somewhere"], "--attach somewhere: expected tcp:HOST:PORT"),
        (["--attach", "tcp:127.0.0.1:5762", "--fault", "reboot"], "--fault reboot belongs to the autopilot"),
        (["--output", "/proc/nowhere"], "--output /proc/nowhere: not writable"),
        (["--scene", "whatever.jpg"], "--scene needs --output"),
        (["--set", "gimbal.speed=3"], "no such number"),
    ],
)
def test_bad_options_are_one_line_and_exit_code_2(
    options: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    port = () if "--port" in options else ("--port", str(free_udp_port()))
    assert run(["simulate", *port, *options]) == 2
    said = capsys.readouterr()
    assert complaint in said.err
    assert said.err.count("\n") == 1
    assert said.out == ""


@pytest.mark.parametrize(("content", "complaint"), [(b"no image", "is no image"), (None, "no such file")])
def test_a_scene_that_is_none_is_named(tmp_path: Path, content: bytes | None, complaint: str) -> None:
    scene = tmp_path / "scene.jpg"
    if content is not None:
        scene.write_bytes(content)
    ended = simulate("--port", str(free_udp_port()), "--scene", str(scene), "--output", str(tmp_path / "out"))
    assert ended.returncode == 2
    assert str(scene) in ended.stderr
    assert complaint in ended.stderr
    assert "Traceback" not in ended.stderr


def test_a_busy_port_to_listen_on_is_one_line_and_exit_code_3(ground: socket.socket) -> None:
    ended = simulate("--listen", "--port", port_of(ground))
    assert ended.returncode == 3
    assert f"UDP port {port_of(ground)} on 127.0.0.1 is in use" in ended.stderr
    assert ended.stderr.count("\n") == 1


def test_listening_it_answers_whoever_talks_first() -> None:
    port = free_udp_port()
    with (
        subprocess.Popen([*SIMULATE, "--listen", "--port", str(port)], stderr=subprocess.PIPE, text=True) as process,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client,
    ):
        assert process.stderr is not None
        process.stderr.readline()
        client.settimeout(60)
        heartbeat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
        client.sendto(heartbeat.pack(mavlink.MAVLink(None, 255, 190)), ("127.0.0.1", port))
        data = client.recv(65535)
        process.terminate()
        process.communicate(timeout=90)
    assert data[0] == 0xFD


async def test_a_program_runs_it_and_gets_its_account(tmp_path: Path) -> None:
    config = SimConfig(port=free_udp_port(), output=tmp_path, speedup=10.0)
    async with running_simulator(config) as simulator:
        assert simulator.ready["output"] == str(tmp_path)
        pid = simulator.process.pid
        assert alive(pid)
    assert simulator.process.returncode == 0
    assert simulator.summary["photos"] == 0
    assert simulator.summary["simulated_s"] > 0
    assert not alive(pid)


async def test_paced_simulation_advances_to_its_limit_and_sends_its_time(ground: socket.socket) -> None:
    config = SimConfig(port=ground.getsockname()[1], speedup=20.0)
    async with running_simulator(config, paced=True) as simulator:
        for until_s in (0.5, 1.2345678):
            simulator.allow(until_s, 20.0)
            told = await asyncio.to_thread(times_until, ground, until_s)
            assert told == sorted(set(told))
            assert told[-1] == pytest.approx(until_s, abs=1e-6)
        simulator.allow(1.0, 20.0)  # it has been there
    assert simulator.summary["simulated_s"] == 1.2345678


def times_until(ground: socket.socket, until_s: float) -> list[float]:
    """What time it was before the messages of each moment, until that time."""
    parser, told = mavlink.MAVLink(None), list[float]()
    while not told or told[-1] < until_s - 1e-6:
        for message in parser.parse_buffer(ground.recv(65535)) or ():
            if message.get_type() == TIME_MESSAGE and message.get_srcComponent() == TIME_COMPONENT:
                told.append(time_from_fields(message.time_boot_ms, message.value))
            else:
                assert told  # nothing comes before its time
    return told


async def test_a_program_gets_its_errors_as_exceptions(tmp_path: Path, ground: socket.socket) -> None:
    with pytest.raises(UsageError, match="no such file"):
        async with running_simulator(SimConfig(output=tmp_path, scene=tmp_path / "none.jpg", port=free_udp_port())):
            pass
    with pytest.raises(LinkError, match="is in use"):
        async with running_simulator(SimConfig(listen=True, port=ground.getsockname()[1])):
            pass


PARENT = """
import asyncio, pathlib, sys
from panoexec.sim.config import SimConfig
from panoexec.sim.pacing import TIME_COMPONENT, TIME_MESSAGE, time_from_fields
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator

async def main():
    config = SimConfig(port=free_udp_port(), output=pathlib.Path(sys.argv[1]))
    async with running_simulator(config) as simulator:
        print(simulator.process.pid, flush=True)
        await asyncio.sleep(60)

asyncio.run(main())
"""


def test_it_does_not_outlive_a_parent_that_was_killed(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", PARENT, str(tmp_path)], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        family = [pid, *children_of(pid)]
        assert len(family) > 1
        parent.kill()
    wait_until(lambda: not any(alive(member) for member in family))


async def test_attaching_waits_for_the_autopilot_and_gives_up() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with pytest.raises(LinkError, match=f"tcp:127.0.0.1:{port}: connection failed"):
        await attach(f"tcp:127.0.0.1:{port}", patience_s=0.3)


@pytest.mark.parametrize(("stop", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 0)])
def test_it_ends_at_once_while_it_waits_for_an_autopilot(stop: signal.Signals, code: int) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # and nobody listens
        url = f"tcp:127.0.0.1:{port_of(taken)}"
        with subprocess.Popen([*SIMULATE, "--attach", url], stderr=subprocess.PIPE, text=True) as process:
            assert process.stderr is not None
            assert process.stderr.readline() == f"waiting for an autopilot at {url}\n"
            process.send_signal(stop)
            _, err = process.communicate(timeout=90)
    assert process.returncode == code, "it would say after 30 s that it has waited in vain"
    assert "connection failed" not in err
    assert "Traceback" not in err
    assert "payload attached" not in err


async def test_the_payload_joins_an_autopilot_again_that_restarts() -> None:
    """A restarting SITL closes its TCP port and opens it again."""
    connections: asyncio.Queue[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = asyncio.Queue()
    notes: list[str] = []
    async with asyncio.timeout(120):
        server = await asyncio.start_server(lambda r, w: connections.put_nowait((r, w)), "127.0.0.1", 0)
        config = SimConfig(attach_url=f"tcp:127.0.0.1:{server.sockets[0].getsockname()[1]}")
        async with running_simulator(config, note=notes.append):
            first = await connections.get()
            assert await heartbeats(first[0]) == {mavlink.MAV_TYPE_GIMBAL, mavlink.MAV_TYPE_CAMERA}
            first[1].close()
            second = await connections.get()
            assert await heartbeats(second[0]) == {mavlink.MAV_TYPE_GIMBAL, mavlink.MAV_TYPE_CAMERA}
        second[1].close()
        server.close()
        await asyncio.gather(first[1].wait_closed(), second[1].wait_closed())
    assert any("reconnecting" in note for note in notes)


async def test_the_payload_lives_the_time_that_its_autopilot_tells() -> None:
    """Five seconds pass at once, as the autopilot says, and none of them is skipped."""
    connections: asyncio.Queue[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = asyncio.Queue()
    stamps_ms: list[int] = []
    async with asyncio.timeout(120):
        server = await asyncio.start_server(lambda r, w: connections.put_nowait((r, w)), "127.0.0.1", 0)
        config = SimConfig(attach_url=f"tcp:127.0.0.1:{server.sockets[0].getsockname()[1]}", speedup=0.01)
        async with running_simulator(config) as simulator:
            reader, writer = await connections.get()
            for boot_us in (2**32 - 1_000_000, 4_000_000):
                writer.write(state_of_autopilot(boot_us))
            parser = mavlink.MAVLink(None)
            while not stamps_ms or stamps_ms[-1] < 4900 - 1000 * config.payload_boot_s:
                heard = parser.parse_buffer(await reader.read(4096)) or ()
                stamps_ms += [m.time_boot_ms for m in heard if m.get_type() == "GIMBAL_DEVICE_ATTITUDE_STATUS"]
        writer.close()
        server.close()
        await writer.wait_closed()
    steps_ms = [later - earlier for earlier, later in itertools.pairwise(stamps_ms) if earlier > 0]
    assert steps_ms
    assert set(steps_ms) == {20}
    assert simulator.summary["simulated_s"] >= 5.0


def state_of_autopilot(boot_us: int) -> bytes:
    """AUTOPILOT_STATE_FOR_GIMBAL_DEVICE (286), level and heading north."""
    message = mavlink.MAVLink_autopilot_state_for_gimbal_device_message(
        1, 154, boot_us, (1.0, 0.0, 0.0, 0.0), 0, 0.0, 0.0, 0.0, 0, 0.0, 0, 0, 0.0
    )
    return bytes(message.pack(mavlink.MAVLink(None, 1, 1)))


async def heartbeats(reader: asyncio.StreamReader) -> set[int]:
    """The types of two components that send heartbeats."""
    parser, kinds = mavlink.MAVLink(None), set[int]()
    while len(kinds) < 2:
        for message in parser.parse_buffer(await reader.read(4096)) or ():
            if message.get_type() == "HEARTBEAT":
                kinds.add(message.type)
    return kinds


def children_of(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()]


def alive(pid: int) -> bool:
    """Whether a process runs; one that only waits to be reaped does not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


async def test_what_one_ground_station_says_is_heard_by_the_other() -> None:
    """As autopilots forward it; commands to the autopilot alone are not."""
    frames = mavlink.MAVLink(None, 1, 191)
    text = mavlink.MAVLink_statustext_message(5, b"Pano: complete").pack(frames)
    command = mavlink.MAVLink_command_long_message(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0).pack(frames)
    simulation = EmbeddedPeer(SimConfig()).simulation
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as daemon,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station,
    ):
        for one in (daemon, station):
            one.bind(("127.0.0.1", 0))
            one.setblocking(False)
        link = UdpLink.sending_to("ground", "127.0.0.1", [one.getsockname()[1] for one in (daemon, station)])
        link.receiver = lambda message, frame: link.forward(frame) if simulation.forwards(message) else None
        link.send(text, None)
        link.flush()
        loop = asyncio.get_running_loop()
        (_, address) = await loop.sock_recvfrom(daemon, 1000)
        assert await loop.sock_recv(station, 1000) == text
        for frame in (command, text):
            await loop.sock_sendto(daemon, frame, ("127.0.0.1", address[1]))
        assert await loop.sock_recv(station, 1000) == text
        with pytest.raises(BlockingIOError):
            daemon.recv(1000)
        link.close()
