"""`pip install .` without extras: plan, verify, send, watch, web and stitch run with what that brings, no more.

A process in which Python finds only the packages of `[project] dependencies` and what these need.
"""

from __future__ import annotations

import asyncio
import http.client
import json
import shutil
import time
import tomllib
from collections.abc import Iterator
from importlib.metadata import packages_distributions, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from panoexec.sim.ports import free_tcp_port
from tests.report_missions import photographed
from tests.repository import ROOT
from tests.support.web import MISSION, fake_vehicle
from tests.system.test_without_extras import PLAN, RUN, command, python
from tests.wire.broker import needs_mosquitto, running_broker

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRA_ALIASES = ("web", "files", "service")


def base() -> set[str]:
    """The distributions that come with panoexec alone."""
    found: set[str] = set()
    wanted = [Requirement(text) for text in PROJECT["dependencies"]]
    while wanted:
        one = wanted.pop()
        name = canonicalize_name(one.name)
        if name not in found and (one.marker is None or one.marker.evaluate({"extra": ""})):
            found.add(name)
            wanted += [Requirement(text) for text in requires(name) or ()]
    return found


def others() -> tuple[str, ...]:
    """What can be imported here and does not come with panoexec alone."""
    kept = base() | {"panoexec", "pip", "setuptools"}
    return tuple(
        sorted(
            module
            for module, owners in packages_distributions().items()
            if module.isidentifier() and not kept & {canonicalize_name(owner) for owner in owners}
        )
    )


MISSING = others()


@pytest.fixture
def port(tmp_path: Path) -> Iterator[int]:
    with running_broker(tmp_path) as broker:
        yield broker.port


async def process(*arguments: object, environment: dict[str, str] | None = None) -> asyncio.subprocess.Process:
    pipe = asyncio.subprocess.PIPE
    line = command(RUN, *map(str, arguments), missing=MISSING)
    return await asyncio.create_subprocess_exec(*line, stdout=pipe, stderr=pipe, env=environment)


def test_what_is_left_out_is_what_the_extras_bring() -> None:
    assert {"mavsdk", "serial", "pymavlink", "matplotlib", "gphoto2", "pytest"} <= set(MISSING)
    assert {"aiohttp", "PIL", "numpy", "aiomqtt", "rich", "pydantic", "structlog"} & set(MISSING) == set()


def test_names_of_former_extras_still_install() -> None:
    assert [PROJECT["optional-dependencies"][name] for name in EXTRA_ALIASES] == [[], [], []]


def test_plans_are_computed_and_verified(tmp_path: Path) -> None:
    plan = tmp_path / "plan.json"
    done = python(RUN, "plan", *PLAN, "--output", str(plan), missing=MISSING)
    assert done.returncode == 0, done.stderr
    done = python(RUN, "verify", str(plan), missing=MISSING)
    assert done.returncode == 0, done.stderr


@needs_mosquitto
async def test_vehicles_are_commanded_and_watched(port: int) -> None:
    async with fake_vehicle(port) as vehicle:
        vehicle.answer = lambda command, _: {"data": {"state": "idle"}} if command == "get" else {}
        sent = await process("send", "get", "--port", port, "--json")
        out, err = await asyncio.wait_for(sent.communicate(), 60)
        assert sent.returncode == 0, err
        assert json.loads(out)["status"] == "ok"
        watched = await process("watch", "--port", port, "--json", "--timeout", 60)
        ended = asyncio.create_task(watched.communicate())
        while not ended.done():  # it watches from the first state of a mission that it hears
            for state in ("capturing", "complete"):
                await vehicle.state(state=state, mission_id=MISSION, shots_total=1, shots_done=1)
            await asyncio.wait({ended}, timeout=0.2)
        out, err = ended.result()
        assert watched.returncode == 0, err
        assert json.loads(out)["state"]["mission_id"] == MISSION


@needs_mosquitto
async def test_the_page_is_served(port: int) -> None:
    at = free_tcp_port()
    server = await process("web", "--listen", f"127.0.0.1:{at}", "--port", port)
    try:
        status, page = await asyncio.wait_for(asyncio.to_thread(_answer, at, server), 60)
        assert (status, b"<title>panoexec" in page) == (200, True), page[:300]
    finally:
        server.terminate()
        _, err = await asyncio.wait_for(server.communicate(), 60)
    assert b"Traceback" not in err, err


def _answer(at: int, server: asyncio.subprocess.Process) -> tuple[int, bytes]:
    while True:
        link = http.client.HTTPConnection("127.0.0.1", at, timeout=30)
        try:
            link.request("GET", "/")
            answer = link.getresponse()
            return answer.status, answer.read()
        except ConnectionRefusedError:
            assert server.returncode is None, "the server has ended"
            time.sleep(0.1)
        finally:
            link.close()


async def test_a_mission_is_stitched(tmp_path: Path) -> None:
    directory = photographed(tmp_path / "20260921T141300.000Z")
    stitched = await process("stitch", str(directory.path), "--width", 512, "--json")
    out, err = await asyncio.wait_for(stitched.communicate(), 120)
    assert b"pip install" not in err
    if shutil.which("nona") is None:
        assert (stitched.returncode, err.startswith(b"panoexec: "), b"hugin-tools" in err) == (3, True, True), err
        return
    # seven photos do not make a whole sphere: what is said of it is a result
    assert stitched.returncode in {0, 1}, err
    assert json.loads(out)["format"] == "panoexec.stitch/1"
    assert (directory.path / "stitch" / "panorama.jpg").exists()
