"""The doctor beside a running daemon: by request and by the verb, idle and in a mission, and where nobody answers."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from pathlib import Path
from typing import Any

from panoexec.sim.config import SimConfig
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.system.daemon import SMALL, SPEEDUP, ground_station, ready, serving, write_config
from tests.wire.broker import needs_mosquitto, running_broker

pytestmark = needs_mosquitto


async def panoexec(*arguments: str) -> tuple[int, str, str]:
    """Run the command line: exit code, standard output, standard error."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "panoexec", *arguments), stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
    )
    try:
        out, err = await process.communicate()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    assert process.returncode is not None
    return process.returncode, out.decode(), err.decode()


def found(document: dict[str, Any], area: str, check: str) -> dict[str, Any]:
    (one,) = [f for f in document["findings"] if (f["area"], f["check"]) == (area, check)]
    return dict(one)


async def test_a_running_daemon_examines_itself_and_a_mission_has_priority(tmp_path: Path) -> None:
    port = free_udp_port()
    simulator = running_simulator(SimConfig(port=port, speedup=SPEEDUP, autopilot="px4"))
    with running_broker(tmp_path) as broker:
        async with simulator, ground_station(broker) as ground, serving(tmp_path, broker, port) as process:
            await ready(ground)
            config = str(tmp_path / "config.toml")
            code, out, said = await panoexec("doctor", "--config", config, "--json")
            document = json.loads(out)
            assert document["examined_by"] == "daemon"
            assert "the daemon is running: it examines itself" in said
            missing = [f for f in document["findings"] if f["verdict"] == "missing" and f["area"] != "rates"]
            assert missing == []
            assert code == (0 if document["healthy"] else 3)
            assert document["autopilot"] == "px4"
            assert found(document, "link", "autopilot")["found"].startswith("PX4 ")
            assert "PX4, system 1 (the first vehicle that was heard)" in found(document, "link", "vehicle")["found"]
            assert found(document, "gimbal", "control")["found"] == "acquired and released"
            assert found(document, "mission", "plan")["verdict"] == "ok"

            # an examination that disturbs ends when a mission begins, and the mission begins undisturbed
            await ground.send("doctor", b'{"transaction": "idle", "photo": true}')
            await ground.send("doctor", b'{"transaction": "twice"}')
            await ground.until(lambda: "twice" in ground.answers)
            assert ground.answers["twice"]["error"]["code"] == "busy"
            assert (await ground.ask("start", "s", **SMALL))["status"] == "ok"
            await ground.until(lambda: "idle" in ground.answers)
            if ground.answers["idle"]["status"] == "error":  # not over before, on a slow computer
                assert ground.answers["idle"]["error"]["code"] == "busy"
                assert "a mission began" in ground.answers["idle"]["error"]["message"]
            await ground.until(lambda: "shot_accepted" in ground.types())
            answer = await ground.ask("doctor", "flying", photo=True)
            assert answer["status"] == "ok"
            flying = answer["data"]
            assert flying["examined_by"] == "daemon"
            if "mission_finished" not in ground.types():
                assert "a mission is under way" in found(flying, "gimbal", "control")["found"]
                assert found(flying, "camera", "photo")["found"] == "not taken: a mission is under way"
                assert found(flying, "mission", "plan")["found"] == "not examined: a mission is under way"
            await ground.until(lambda: ground.state["state"] == "complete")
            assert ground.misfits == []

            code, out, _ = await panoexec("send", "doctor", "--port", str(broker.port), "--timeout", "300")
            assert code == 0, out
            assert "link: examined by" in out

            # a daemon that does not answer keeps its link
            process.send_signal(signal.SIGSTOP)
            code, out, _ = await panoexec("doctor", "--config", config, "--json")
            process.send_signal(signal.SIGCONT)
            document = json.loads(out)
            assert (code, document["examined_by"]) == (3, "doctor")
            named = found(document, "link", "port")
            assert f"UDP port {port} is in use by process {process.pid}" in named["found"]
            assert "did not respond to get" in named["found"]
            assert [f for f in document["findings"] if f["area"] == "gimbal"] == []
            assert found(document, "disk", "storage")["verdict"] == "ok", "the rest is examined all the same"


async def test_without_a_broker_the_daemon_is_named_and_left_alone(tmp_path: Path) -> None:
    port = free_udp_port()
    with running_broker(tmp_path) as broker:
        config = write_config(tmp_path, broker, port)
    text = config.read_text().replace('host = "127.0.0.1"\n', "")
    config.write_text(text)
    environment = {name: value for name, value in os.environ.items() if name != "NOTIFY_SOCKET"}
    daemon = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "panoexec", "serve", "--config", str(config)),
        stderr=asyncio.subprocess.PIPE,
        env=environment,
    )
    try:
        assert daemon.stderr is not None
        async with asyncio.timeout(300):
            while b"links" not in (line := await daemon.stderr.readline()):
                assert line, "it ended"
        code, out, _ = await panoexec("doctor", "--config", str(config), "--json")
    finally:
        daemon.kill()
        await daemon.communicate()
    document = json.loads(out)
    assert (code, document["examined_by"]) == (3, "doctor")
    named = found(document, "link", "port")
    assert f"is in use by process {daemon.pid}" in named["found"]
    assert "[mqtt] host is not set" in named["found"]
