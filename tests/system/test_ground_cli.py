"""`send` and `watch` as processes, with the daemon, a simulated vehicle and a real broker."""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import re
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import aiomqtt
import pytest

from panoexec.cli.app import run
from panoexec.sim.config import SimConfig
from panoexec.sim.ports import free_tcp_port, free_udp_port
from panoexec.sim.process import running_simulator
from tests.system.daemon import SPEEDUP, ground_station, ready, serving
from tests.waiting import eventually
from tests.wire.broker import Broker, needs_mosquitto, running_broker

pytestmark = needs_mosquitto

ROW = ("elevation_deg=[-30,0]", "azimuth_deg=[0,120]", "method=paper")


@asynccontextmanager
async def panoexec(*arguments: object) -> AsyncIterator[asyncio.subprocess.Process]:
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "panoexec", *map(str, arguments)),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        yield process
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


async def outcome(*arguments: object) -> tuple[int, str, str]:
    """Exit code, standard output and error of a verb; in a thread, as starting a process takes long."""
    out, err = io.StringIO(), io.StringIO()

    def call() -> int:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            return run([str(argument) for argument in arguments])

    code = await asyncio.to_thread(call)
    return code, out.getvalue(), err.getvalue()


async def document(process: asyncio.subprocess.Process) -> dict[str, Any]:
    """The one JSON document of a process that ends."""
    out, err = await asyncio.wait_for(process.communicate(), 180)
    assert out, err.decode()
    return dict(json.loads(out))


async def sends(broker: Broker) -> None:
    """What `send` prints and how it ends."""
    where = ("--port", broker.port)
    code, out, _ = await outcome("send", "plan", *ROW, *where, "overlap=0.2", "tolerance_deg.yaw=1.0", "--json")
    answer = json.loads(out)
    assert (code, answer["status"]) == (0, "ok")
    assert answer["data"]["images"] >= 2
    code, out, _ = await outcome("send", *where, "get")
    assert code == 0
    assert "idle" in out
    code, out, err = await outcome("status", *where)
    assert code == 0, err
    assert out.startswith("drone: idle")
    assert "link: autopilot, gimbal and camera answer" in out
    code, out, err = await outcome("send", "pause", *where)
    assert (code, out) == (1, "")
    assert "drone rejected pause: refused: cannot pause: no mission is under way" in err
    code, _, err = await outcome("send", "plan", "overlap=2", *where)
    assert code == 2
    assert "invalid (overlap)" in err


async def operates(broker: Broker) -> None:
    """The operator's verbs from the start of a mission to its end."""
    where = ("--port", broker.port)
    wanted = ("--elevation", -60, 30, "--method", "paper", "--tolerance-yaw", 1, "--name", "quarry")
    code, out, err = await outcome("start", *wanted, *where)
    assert code == 0, err
    begins = re.match(r"drone: mission \S+ begins: (\d+) images in \d+ rows?, about \d+ s; (not )?certified", out)
    assert begins, out
    code, out, err = await outcome("pause", "rain", *where)
    assert code == 0, err
    assert re.match(r"drone: mission \S+ (is paused|pauses after the current photo \(it is \w+\))\n", out)
    code, out, _ = await outcome("status", *where)
    assert code == 0
    assert re.search(r'mission \S+ "quarry": \d+ of \d+ shots done', out)
    last = int(begins[1]) - 1
    code, out, err = await outcome("skip", last, *where, "--json")
    assert code == 0, out + err
    assert json.loads(out)["data"]["shot"] == last
    code, out, err = await outcome("skip", "999", *where)
    assert (code, out) == (1, "")
    assert "drone rejected skip" in err
    code, out, err = await outcome("resume", *where)
    assert code == 0, err
    assert "goes on" in out
    code, out, err = await outcome("abort", *where)
    assert code == 0, err
    assert re.match(r"drone: mission \S+ is (being )?aborted", out), out
    code, out, err = await outcome("skip", "-1", *where)
    assert (code, out) == (2, "")
    assert "unknown option -1" in err or "not a whole number" in err


async def test_send_and_watch_from_the_first_answer_to_the_last_event(tmp_path: Path) -> None:
    port = free_udp_port()
    with running_broker(tmp_path) as broker:
        simulator = running_simulator(SimConfig(port=port, speedup=SPEEDUP))
        async with simulator, ground_station(broker) as ground, serving(tmp_path, broker, port):
            await ready(ground)
            await sends(broker)
            watching = ("watch", "--port", broker.port, "--json", "--timeout", 600)
            async with panoexec(*watching) as one, panoexec(*watching, "--all") as fleet:
                async with aiomqtt.Client("127.0.0.1", broker.port) as other:
                    await other.publish("panoexec/kite/status", "offline", qos=1, retain=True)
                    await listening(broker, 2)
                    code, out, err = await outcome("send", "start", *ROW, "--port", broker.port, "--json")
                    assert code == 0, err
                    seen = await document(one)
                assert one.returncode == 0
                assert (seen["status"], seen["state"]["state"]) == ("online", "complete")
                assert seen["state"]["mission_id"] == json.loads(out)["data"]["mission_id"]
                numbers = [int(event["id"].rpartition("/")[2]) for event in seen["events"]]
                assert numbers == list(range(numbers[0], numbers[-1] + 1)), "each event once, in order"
                assert seen["events"][-1]["type"] == "mission_finished"
                fleet.send_signal(signal.SIGINT)
                all_seen = await document(fleet)
                assert fleet.returncode == 130
                assert all_seen["kite"]["status"] == "offline"
                assert all_seen["drone"]["status"] == "online"
                assert all_seen["drone"]["events"]
            await operates(broker)
            async with panoexec("watch", "--port", broker.port) as one:
                await listening(broker, 3)
                answer = await ground.ask("start", "long", method="paper")
                assert answer["status"] == "ok", answer
                assert (await ground.ask("abort", "rain", reason="rain"))["status"] == "ok"
                _, err_bytes = await asyncio.wait_for(one.communicate(), 180)
                assert one.returncode == 1
                assert "aborted" in err_bytes.decode()


async def listening(broker: Broker, times: int) -> None:
    """Wait until the broker has let so many of `watch`, counted from its start, listen to the last of their topics."""
    await eventually(lambda: broker.log.read_text(encoding="utf-8").count("/event (QoS 1)") >= times, 60)


def acknowledged(broker: Broker) -> int:
    """How many messages ground stations of the command line have acknowledged."""
    return broker.log.read_text(encoding="utf-8").count("Received PUBACK from panoexec-ground-")


async def test_nobody_answers(tmp_path: Path) -> None:
    with running_broker(tmp_path) as broker:
        code, out, err = await outcome("send", "get", "--port", broker.port, "--timeout", "0.3")
        assert (code, out) == (3, "")
        assert "drone did not respond to get within 0.3 s: no vehicle of this id has been connected" in err
        assert "whether it received the request is not known" in err
        async with aiomqtt.Client("127.0.0.1", broker.port) as other:
            await other.publish("panoexec/owl/status", "offline", qos=1, retain=True)
        code, out, err = await outcome("start", "--port", broker.port, "--vehicle", "owl")
        assert (code, out) == (3, "")
        assert "owl is offline: its daemon is not connected to this broker" in err
        code, out, err = await outcome("pause", "a", "helicopter", "--port", broker.port, "--vehicle", "owk")
        assert (code, out) == (3, "")
        assert "no vehicle owk has been connected to this broker: did you mean owl? The request was sent: one" in err
        code, _, err = await outcome("watch", "--port", broker.port, "--timeout", "0.5", "--vehicle", "kite")
        assert code == 3
        assert "no message received from kite" in err
        code, _, err = await outcome("watch", "--all", "--port", broker.port, "--timeout", "0.5", "--prefix", "other")
        assert code == 0
        assert "no message received from any vehicle below other/" in err


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["send", "fly"], 2, "unknown command 'fly'"),
        (["send", "pausee"], 2, "did you mean 'pause'"),
        (["send", "skip", "shot"], 2, "expected KEY=VALUE"),
        (["send", "skip", "a=1", "a.b=2"], 2, "a already has a value"),
        (["send", "plan", "--plan", "none.json"], 2, "none.json"),
        (["send", "get", "--vehicle", "a/b"], 2, "an id must not contain / + or #"),
        (["watch", "--prefix", "/x"], 2, "not a topic prefix"),
        (["watch", "--password-file", "x"], 2, "password_file needs username"),
    ],
)
def test_wrong_usage(arguments: list[str], code: int, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(arguments) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert says in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("verb", [["send", "get"], ["watch"]])
def test_no_broker(verb: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    port = free_tcp_port()
    assert run([*verb, "--port", str(port)]) == 3
    assert f"no connection to broker 127.0.0.1:{port}: nothing listens on" in capsys.readouterr().err


async def test_watch_waits_for_a_broker_that_goes_away(tmp_path: Path) -> None:
    with running_broker(tmp_path) as broker:
        async with panoexec("watch", "--all", "--port", broker.port, "--json") as watching:
            await listening(broker, 1)
            broker.stop(kill=True)
            broker.start()
            await listening(broker, 2)
            async with aiomqtt.Client("127.0.0.1", broker.port) as other:
                # once the fifth is acknowledged, the first has long been taken in
                for number in range(1, 6):
                    await other.publish("panoexec/kite/status", "online", qos=1)
                    await eventually(partial(lambda least: acknowledged(broker) >= least, number), 60)
            watching.send_signal(signal.SIGINT)
            seen = await document(watching)
            assert watching.returncode == 130
    assert seen["kite"]["status"] == "online"
