"""Strangers, slow browsers and floods: the server stays up, and obeys nothing that it must not."""

# ruff: noqa: SIM117  (what is open inside of what is easier to see)
from __future__ import annotations

import asyncio
import json
import socket
import ssl
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

import aiohttp
import pytest
from aiohttp.abc import AbstractResolver, ResolveResult
from yarl import URL

from panoexec.errors import UsageError
from panoexec.inputs.service_sections import MqttSection, WebSection
from panoexec.web import sockets
from panoexec.web.protocol import MAX_FRAME
from panoexec.web.server import Options, Server
from panoexec.web.users import new_user, write_users
from tests.support.web import FakeBrowser, FakeVehicle, base, browser, fake_vehicle, web_server
from tests.waiting import eventually
from tests.wire.broker import Broker, needs_mosquitto, running_broker
from tests.wire.certificates import Authority, needs_openssl

pytestmark = needs_mosquitto
PAUSE = {"type": "command", "id": "pause-0001", "vehicle": "drone", "command": "pause", "fields": {}}


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with running_broker(tmp_path, verbose=False) as one:
        yield one


@pytest.fixture
def users_file(tmp_path: Path) -> Path:
    path = tmp_path / "users"
    users = (new_user("anna", "operator", "correct horse"), new_user("bert", "viewer", "battery staple"))
    write_users(path, {user.name: user for user in users})
    return path


@asynccontextmanager
async def session_of(server: Server, name: str = "", password: str = "") -> AsyncIterator[aiohttp.ClientSession]:
    async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session:
        if name:
            await session.post(
                f"{base(server)}/login",
                data={"name": name, "password": password},
                headers={"Origin": base(server)},
                allow_redirects=False,
            )
        yield session


async def refused(session: aiohttp.ClientSession, server: Server, origin: str | None = None) -> int:
    """The status with which a WebSocket is refused; 101 if it is not."""
    try:
        async with session.ws_connect(f"{base(server)}/socket", origin=origin):
            return 101
    except aiohttp.WSServerHandshakeError as error:
        return error.status


async def still_works(server: Server, vehicle: FakeVehicle, number: str) -> None:
    before = len(vehicle.requests)
    async with browser(server, follow="drone") as page:
        assert (await page.command(number, "pause"))["stage"] == "done"
    assert len(vehicle.requests) == before + 1


async def test_only_our_own_page_opens_the_socket(broker: Broker) -> None:
    async with fake_vehicle(broker.port) as vehicle, web_server(broker.port) as server, session_of(server) as session:
        for origin in ("http://evil.example", f"{base(server)}.evil.example", "null", "http://127.0.0.1:1", ""):
            assert await refused(session, server, origin=origin) == 403, origin
        assert await refused(session, server) == 403, "no origin is none of ours"
        rebound = {"Host": "evil.example", "Origin": "http://evil.example"}
        for path in ("/", "/socket", "/api/missions", "/assets/index.html"):
            async with session.get(base(server) + path, headers=rebound) as answer:
                assert answer.status == 403, path
        async with session.post(f"{base(server)}/logout", headers={"Origin": "http://evil.example"}) as answer:
            assert answer.status == 403
        assert not vehicle.requests
        await still_works(server, vehicle, "pause-0002")


async def test_with_users_nobody_gets_in_without_a_login_and_a_viewer_only_looks(
    broker: Broker, users_file: Path
) -> None:
    async with fake_vehicle(broker.port) as vehicle, web_server(broker.port, users_file=users_file) as server:
        async with session_of(server) as stranger:
            assert await refused(stranger, server, origin=base(server)) == 401
            for path in ("/api/missions", "/thumbnails/drone/20261122T075801.864Z/0", "/missions/x/report"):
                async with stranger.get(base(server) + path) as answer:
                    assert answer.status == 401, path
            async with stranger.get(f"{base(server)}/v/drone", allow_redirects=False) as answer:
                assert (answer.status, answer.headers["Location"]) == (303, "/login")
            for path in ("/login", "/register_service", "/assets/login.html"):
                async with stranger.get(base(server) + path) as answer:
                    assert answer.status == 200, path
            stranger.cookie_jar.update_cookies({"panoexec_session": "guess"}, URL(base(server)))
            assert await refused(stranger, server, origin=base(server)) == 401
            form = {"name": "anna", "password": "correct horse"}
            async with stranger.post(f"{base(server)}/login", data=form, allow_redirects=False) as answer:
                assert answer.status == 403, "a form of another page has another origin"
        async with session_of(server, "bert", "battery staple") as viewer:
            cookie = next(iter(viewer.cookie_jar))
            assert (cookie["httponly"], cookie["samesite"]) == (True, "Strict")
            async with viewer.ws_connect(f"{base(server)}/socket", origin=base(server)) as one:
                page = FakeBrowser(one)
                listening = asyncio.create_task(page.run())
                assert (await page.until("hello"))["role"] == "viewer"
                for number, command in enumerate(("pause", "abort", "start", "set_profile", "doctor")):
                    answered = await page.command(f"command-{number}", command)
                    assert answered["error"]["code"] == "role", command
                assert not vehicle.requests
                assert (await page.command("get-000001", "get"))["stage"] == "done"
                # the user is removed while the page is open
                write_users(users_file, {"anna": new_user("anna", "operator", "correct horse")})
                await eventually(page.closed.is_set)
                await listening
        async with session_of(server, "anna", "correct horse") as operator:
            async with operator.ws_connect(f"{base(server)}/socket", origin=base(server)) as one:
                page = FakeBrowser(one)
                listening = asyncio.create_task(page.run())
                await page.say(type="name", name="somebody else")
                assert (await page.command("pause-0001", "pause"))["stage"] == "done"
                assert vehicle.requests[-1][1]["reason"] == "by anna", "the log has the login, not what the page says"
                async with operator.post(f"{base(server)}/logout", headers={"Origin": base(server)}) as answer:
                    assert answer.status == 200
                await eventually(page.closed.is_set)
                await listening


async def test_guessing_passwords_is_slowed_down(broker: Broker, users_file: Path) -> None:
    async with web_server(broker.port, users_file=users_file) as server, session_of(server) as session:
        ends = []
        for _ in range(8):
            async with session.post(
                f"{base(server)}/login",
                data={"name": "anna", "password": "guess"},
                headers={"Origin": base(server)},
                allow_redirects=False,
            ) as answer:
                ends.append(answer.headers["Location"])
        assert ends == ["/login?failed=wrong"] * 5 + ["/login?failed=wait"] * 3


def test_an_address_that_others_reach_needs_users() -> None:
    for host in ("0.0.0.0", "192.168.1.2", "::"):
        options = Options(mqtt=MqttSection(host="127.0.0.1"), web=WebSection(), host=host, port=0)
        with pytest.raises(UsageError, match="--add-user"):
            Server(options)


async def test_no_path_leads_out_of_the_files_of_the_page(broker: Broker) -> None:
    async with web_server(broker.port) as server:
        for path in (
            "/assets/../server.py",
            "/assets/..%2fserver.py",
            "/assets/%2e%2e/%2e%2e/pyproject.toml",
            "/assets//etc/passwd",
            "/assets/report/../../cli/app.py",
            "/assets/%00",
            "/v/../../etc",
            "/v/%2e%2e",
            "/thumbnails/drone/..%2f..%2fetc/0",
            "/missions/..%2f..%2fetc/report",
            "//etc/passwd",
        ):
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            writer.write(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n".encode())
            answer = await reader.read()
            writer.close()
            assert answer.split(b" ")[1] in (b"404", b"400"), (path, answer[:200])
            assert b"root:" not in answer


async def test_every_answer_has_its_security_headers(broker: Broker) -> None:
    async with web_server(broker.port) as server, session_of(server) as session:
        for path, status in (("/", 200), ("/nothing", 404), ("/assets/index.html", 200), ("/api/missions", 200)):
            async with session.get(base(server) + path) as answer:
                assert answer.status == status
                policy = answer.headers["Content-Security-Policy"]
                assert "default-src 'none'" in policy
                assert "unsafe" not in policy
                assert answer.headers["X-Content-Type-Options"] == "nosniff"
                assert "aiohttp" not in answer.headers["Server"].lower()


async def test_giant_frames_and_floods_end_the_connection_and_nothing_else(broker: Broker) -> None:
    async with fake_vehicle(broker.port) as vehicle, web_server(broker.port) as server:
        for data in ("x" * (MAX_FRAME + 1), json.dumps(PAUSE | {"fields": {"reason": "x" * MAX_FRAME}})):
            async with browser(server) as page:
                await page._socket.send_str(data)
                await eventually(page.closed.is_set)
        async with browser(server) as page:
            await page._socket.send_bytes(b"\x00" * 100)
            await eventually(page.closed.is_set)
        async with browser(server) as page:
            for _ in range(200):
                if page.closed.is_set():
                    break
                await page._socket.send_str("{}")
            await eventually(page.closed.is_set)
        assert not vehicle.requests
        await still_works(server, vehicle, "pause-0003")


async def test_a_browser_that_reads_nothing_is_cut_off_and_costs_the_others_nothing(broker: Broker) -> None:
    async with fake_vehicle(broker.port) as vehicle, web_server(broker.port) as server:
        raw = socket.create_connection(("127.0.0.1", server.port))
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        head = f"GET /socket HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nOrigin: {base(server)}\r\n"
        head += "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        raw.sendall((head + "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n").encode())
        follow = json.dumps({"type": "follow", "vehicle": "drone"}).encode()
        raw.sendall(bytes([0x81, 0x80 | len(follow), 0, 0, 0, 0]) + follow)
        await eventually(lambda: len(server._browsers.all) == 1)
        async with browser(server, follow="drone") as page:
            for number in range(120):
                await vehicle.state(reason=f"{number} " + "x" * 100_000)
            await page.until("state", lambda one: one["state"]["reason"].startswith("119 "))
            await eventually(lambda: len(server._browsers.all) == 1)
        raw.close()
        await still_works(server, vehicle, "pause-0004")


async def test_a_thousand_sockets_leave_it_up(broker: Broker, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sockets, "_PING_S", 600.0)  # nobody reads them: on a slow machine the first would be gone
    async with fake_vehicle(broker.port) as vehicle, web_server(broker.port) as server, AsyncExitStack() as stack:
        connector = aiohttp.TCPConnector(limit=0)
        session = await stack.enter_async_context(aiohttp.ClientSession(connector=connector))

        async def one_more() -> int:
            try:
                await stack.enter_async_context(session.ws_connect(f"{base(server)}/socket", origin=base(server)))
            except aiohttp.WSServerHandshakeError as error:
                return error.status
            return 101

        statuses = []
        for _ in range(10):
            statuses += await asyncio.gather(*(one_more() for _ in range(100)))
        assert statuses.count(101) == sockets.MOST
        assert statuses.count(503) == 1000 - sockets.MOST
        await stack.aclose()
        await eventually(lambda: not server._browsers.all)
        await still_works(server, vehicle, "pause-0005")


async def test_a_thousand_connections_that_say_nothing_keep_nobody_out(broker: Broker) -> None:
    async with fake_vehicle(broker.port) as vehicle, web_server(broker.port) as server:
        idle = [await asyncio.open_connection("127.0.0.1", server.port) for _ in range(1000)]
        for _, writer in idle[:500]:
            writer.write(b"GET / HTTP/1.1\r\nHost: 127")  # never ends
        await still_works(server, vehicle, "pause-0006")
        for _, writer in idle:
            writer.close()


class LocalHost(AbstractResolver):
    """Resolves every name to this machine: not every machine has a name of its own in /etc/hosts."""

    async def resolve(
        self, host: str, port: int = 0, family: socket.AddressFamily = socket.AF_INET
    ) -> list[ResolveResult]:
        del family
        return [ResolveResult(hostname=host, host="127.0.0.1", port=port, family=socket.AF_INET, proto=0, flags=0)]

    async def close(self) -> None:
        """There is nothing to close."""


@needs_openssl
async def test_with_a_certificate_the_page_is_served_by_tls_and_the_cookie_is_for_tls(
    broker: Broker, users_file: Path, tmp_path: Path
) -> None:
    authority = Authority(tmp_path / "ca")
    issued = authority.issue("localhost")
    files = {"cert_file": issued.cert, "key_file": issued.key}
    async with web_server(broker.port, users_file=users_file, **files) as server:
        url = f"https://localhost:{server.port}"
        context = ssl.create_default_context(cafile=str(authority.cert))
        trust = aiohttp.TCPConnector(ssl=context, resolver=LocalHost())
        async with aiohttp.ClientSession(connector=trust, headers={"Origin": url}) as session:
            form = {"name": "anna", "password": "correct horse"}
            async with session.post(f"{url}/login", data=form, allow_redirects=False) as answer:
                assert answer.cookies["panoexec_session"]["secure"]
            async with session.ws_connect(f"{url}/socket", origin=url) as one:
                assert json.loads(await one.receive_str())["user"] == "anna"
        with pytest.raises(aiohttp.ClientError):
            async with aiohttp.ClientSession() as plain, plain.get(f"http://127.0.0.1:{server.port}/"):
                pass


def test_a_certificate_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    (tmp_path / "c").write_text("none", encoding="utf-8")
    web = WebSection(cert_file=tmp_path / "c", key_file=tmp_path / "c")
    options = Options(mqtt=MqttSection(host="127.0.0.1"), web=web, host="127.0.0.1", port=0)
    with pytest.raises(UsageError, match="cert_file"):
        Server(options)
