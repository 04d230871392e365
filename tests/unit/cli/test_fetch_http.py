"""`fetch --url`: a mission comes by HTTP whole, resumed where it broke off; odd servers leave nothing behind."""

from __future__ import annotations

import io
import json
import threading
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from panoexec.cli import fetch_http
from panoexec.cli.app import run
from panoexec.importing.card_import import carry_out, plan_import
from panoexec.report.mission_outputs import restore_outputs
from panoexec.store.directory import MissionDirectory
from tests.unit.importing.cards import a_mission, take, write_photo

ID = "20260921T141320.000Z"


@pytest.fixture
def mission(tmp_path: Path) -> MissionDirectory:
    """A mission of five shots with their photos."""
    taken, card = take(5, seed=1), tmp_path / "card"
    directory = a_mission(tmp_path / "drone", taken)
    for number, one in enumerate(taken):
        write_photo(card / f"{number}.JPG", one.time_s, content=number)
    carry_out(plan_import(directory, card), how="copy")
    restore_outputs(directory)
    return directory


def archive_of(folder: Path) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                archive.write(path, f"{folder.name}/{path.relative_to(folder)}")
    return out.getvalue()


def archive(*entries: tuple[str, bytes], compression: int = zipfile.ZIP_STORED) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", compression) as made:
        for name, content in entries:
            made.writestr(name, content)
    return out.getvalue()


def encrypted(content: bytes) -> bytes:
    """The archive of one file, flagged as encrypted in both of its headers."""
    out = bytearray(content)
    out[6] |= 1
    out[content.index(b"PK\x01\x02") + 8] |= 1
    return bytes(out)


class Server:
    """A page that serves one archive, as a test wants.

    Attributes:
        cuts: after how many bytes each of the next answers breaks off.
        answers: by path, instead of what is usual: status, headers, body.
        asked: ranges of the requests for the archive.
    """

    def __init__(self, name: str, content: bytes) -> None:
        self.name, self.content, self.tag = name, content, '"1"'
        self.cuts: list[int] = []
        self.answers: dict[str, tuple[int, dict[str, str], bytes]] = {}
        self.asked: list[str] = []
        self.password = ""
        self.url = ""

    def get(self, request: Any) -> None:
        path = request.path
        if self.password and "s=1" not in request.headers.get("Cookie", ""):
            self.send(request, 401, {}, b"")
        elif path in self.answers:
            self.send(request, *self.answers[path])
        elif path == "/api/missions":
            document = {"missions": [{"mission_id": self.name}, {"mission_id": "../../etc"}]}
            self.send(request, 200, {"Content-Type": "application/json"}, json.dumps(document).encode())
        elif path == f"/missions/{self.name}/download":
            self.download(request)
        else:
            self.send(request, 404, {}, b"")

    def post(self, request: Any) -> None:
        body = request.rfile.read(int(request.headers["Content-Length"])).decode()
        right = body == f"name=ANNA&password={self.password}" and request.headers.get("Origin") == self.url
        answer = {"Location": "/", "Set-Cookie": "s=1; HttpOnly"} if right else {"Location": "/login?failed=wrong"}
        self.send(request, 303, answer, b"")

    def download(self, request: Any) -> None:
        asked = request.headers.get("Range", "")
        self.asked.append(asked)
        start = int(asked[6:-1]) if asked and request.headers.get("If-Range") == self.tag else 0
        headers = {"Content-Type": "application/zip", "ETag": self.tag}
        if start:
            headers["Content-Range"] = f"bytes {start}-{len(self.content) - 1}/{len(self.content)}"
        self.send(request, 206 if start else 200, headers, self.content[start:])

    def send(self, request: Any, status: int, headers: dict[str, str], body: bytes) -> None:
        request.send_response(status)
        for name, value in headers.items():
            request.send_header(name, value)
        if "Content-Length" not in headers:
            request.send_header("Content-Length", str(len(body)))
        request.end_headers()
        cut = self.cuts.pop(0) if self.cuts and body and status in {200, 206} else len(body)
        request.wfile.write(body[:cut])
        if cut < len(body):
            request.close_connection = True


@contextmanager
def serving(name: str, content: bytes) -> Iterator[Server]:
    page = Server(name, content)

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            page.get(self)

        def do_POST(self) -> None:
            page.post(self)

        def log_message(self, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    page.url = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    try:
        yield page
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fetch_http, "_PAUSE_S", 0.0)
    monkeypatch.setattr(fetch_http, "_TRIES", 2)
    monkeypatch.setattr(fetch_http, "_TIMEOUT_S", 5.0)


def same(one: Path, other: Path) -> bool:
    files = {path.relative_to(one): path.read_bytes() for path in one.rglob("*") if path.is_file()}
    return files == {path.relative_to(other): path.read_bytes() for path in other.rglob("*") if path.is_file()}


def test_the_newest_mission_comes_whole_and_goes_on_where_it_broke_off(
    mission: MissionDirectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    here = tmp_path / "here"
    with serving(mission.mission_id, archive_of(mission.path)) as page:
        # each of the next answers breaks off a little later: the list of missions is no archive, and is whole
        page.cuts = [1 << 20, 5000, 9000, 70]
        assert run(["fetch", "--url", page.url, "--to", str(here)]) == 0
        assert page.asked == ["", "bytes=4999-", "bytes=13998-", "bytes=14067-"]
    shown = capsys.readouterr()
    assert shown.out.strip() == str(here / mission.mission_id)
    assert "goes on at" in shown.err
    assert same(mission.path, here / mission.mission_id)
    assert {path.name for path in here.iterdir()} == {mission.mission_id}, "no part is left"


def test_another_run_continues_unless_the_mission_has_changed(
    mission: MissionDirectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    here, name = tmp_path / "here", mission.mission_id
    with serving(name, archive_of(mission.path)) as page:
        page.cuts = [6000, 0, 0, 0]
        assert run(["fetch", name, "--url", page.url, "--to", str(here)]) == 3
        assert "continued by the same command" in capsys.readouterr().err
        assert not (here / name).exists(), "nothing half"
        page.asked.clear()
        page.cuts = [100, 0, 0, 0]
        assert run(["fetch", name, "--url", page.url, "--to", str(here)]) == 3
        assert page.asked[0] == "bytes=5999-"
        (mission.images / "0.JPG").unlink()
        page.content, page.tag, page.cuts = archive_of(mission.path), '"2"', []
        assert run(["fetch", name, "--url", page.url, "--to", str(here), "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["problems"] == ["shot 0: images/0.JPG is missing"]
    assert same(mission.path, here / name)


def test_a_copy_that_has_more_than_the_page_is_left_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    taken, card, here = take(5, seed=1), tmp_path / "card", tmp_path / "here"
    mission = a_mission(tmp_path / "drone", taken)
    restore_outputs(mission)
    for number, one in enumerate(taken):
        write_photo(card / f"{number}.JPG", one.time_s, content=number)
    fetch = ["fetch", mission.mission_id, "--to", str(here), "--url"]
    with serving(mission.mission_id, archive_of(mission.path)) as page:
        assert run([*fetch, page.url]) == 0
        assert run([*fetch, page.url]) == 0, "the same again changes nothing"
        copy = MissionDirectory(here / mission.mission_id)
        carry_out(plan_import(copy, card), how="move")
        journal = copy.journal.read_bytes()
        capsys.readouterr()
        assert run([*fetch, page.url]) == 2
    assert "more than the mission there" in capsys.readouterr().err
    assert copy.journal.read_bytes() == journal
    assert len(list(copy.images.iterdir())) == 5


def test_a_page_with_logins_gets_one(
    mission: MissionDirectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    here, secret = tmp_path / "here", tmp_path / "password"
    secret.write_text("tell-nobody\n")
    with serving(mission.mission_id, archive_of(mission.path)) as page:
        page.password = "tell-nobody"
        arguments = ["fetch", "--url", page.url, "--to", str(here)]
        assert run(arguments) == 3
        assert "needs a login: --user NAME" in capsys.readouterr().err
        login = [*arguments, "--user", "ANNA", "--password-file", str(secret)]
        assert run(login) == 2
        assert "everybody on this computer may read it" in capsys.readouterr().err
        secret.chmod(0o600)
        assert run(login) == 0
        secret.write_text("guessed\n")
        assert run(login) == 3
        assert "wrong name or password" in capsys.readouterr().err


HTML = {"Content-Type": "text/html"}
ZIP = {"Content-Type": "application/zip"}


@pytest.mark.parametrize(
    ("answer", "code", "why"),
    [
        ((200, HTML, b"<html></html>"), 3, "is no archive"),
        ((302, {"Location": "http://198.51.100.7/"}, b""), 3, "redirects, which is refused"),
        ((404, {}, b""), 2, "there is no mission"),
        ((500, {}, b""), 3, "HTTP 500"),
        ((503, {}, b""), 3, "HTTP 503"),
        ((200, ZIP | {"Content-Length": str(10**17)}, b"PK"), 3, "MB are free"),
        ((200, ZIP, b"PK" * 500), 3, "the archive is damaged"),
        ((200, ZIP, archive(("../evil", b"x"))), 3, "which is no file of a mission"),
        ((200, ZIP, archive((f"{ID}/../../evil", b"x"))), 3, "which is no file of a mission"),
        ((200, ZIP, archive(("/etc/evil", b"x"))), 3, "which is no file of a mission"),
        ((200, ZIP, archive((f"{ID}/.ssh/evil", b"x"))), 3, "which is no file of a mission"),
        ((200, ZIP, archive(("20200101T000000.000Z/evil", b"x"))), 3, "which is no file of a mission"),
        ((200, ZIP, archive((f"{ID}/a", bytes(9999)), compression=zipfile.ZIP_DEFLATED)), 3, "is compressed"),
        ((200, ZIP, encrypted(archive((f"{ID}/a", b"x")))), 3, "the archive is damaged"),
        ((200, ZIP, archive((f"{ID}/ä", b"x")).replace("ä".encode(), b"\xff\xff")), 3, "the archive is damaged"),
        ((206, ZIP | {"Content-Range": "bytes 7-8/9"}, b"xx"), 3, "does not tell its size"),
    ],
)
def test_what_is_no_mission_is_named_and_leaves_nothing_behind(
    tmp_path: Path, answer: tuple[int, dict[str, str], bytes], code: int, why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    here = tmp_path / "here"
    with serving(ID, b"") as page:
        page.answers[f"/missions/{ID}/download"] = answer
        assert run(["fetch", ID, "--url", page.url, "--to", str(here)]) == code
    assert why in capsys.readouterr().err
    assert {path.name for path in here.rglob("*") if path.is_file()} <= {f".{ID}.zip.part", f".{ID}.zip.part.etag"}
    assert not (tmp_path / "evil").exists()


def test_a_damaged_archive_begins_anew(tmp_path: Path, mission: MissionDirectory) -> None:
    here, whole = tmp_path / "here", archive_of(mission.path)
    at = whole.index(b"\xff\xd8") + 40
    with serving(mission.mission_id, whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :]) as page:
        assert run(["fetch", "--url", page.url, "--to", str(here)]) == 3
        page.content = whole
        assert run(["fetch", "--url", page.url, "--to", str(here)]) == 0
    assert same(mission.path, here / mission.mission_id)


def _strip(page: Server) -> list[str]:
    return ["fetch", "--url", page.url.replace("http://", "http://anna:secret@")]


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (lambda page: ["fetch", "--url", f"{page.url}/v/drone"], "expected http://HOST:PORT"),
        (lambda _: ["fetch", "--url", "ftp://drone"], "expected http://HOST:PORT"),
        (lambda _: ["fetch", "--url", "http://drone:99999"], "expected http://HOST:PORT"),
        (_strip, "--url has a login in it"),
        (lambda _: ["fetch", "--from", "drone", "--user", "ANNA"], "are for --url"),
        (lambda page: ["fetch", "--url", page.url, "--user", "ANNA"], "needs --password-file"),
        (lambda page: ["fetch", "../etc", "--url", page.url], "not a mission id"),
    ],
)
def test_what_makes_no_sense_is_named(
    arguments: Callable[[Server], list[str]], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with serving(ID, b"") as page:
        assert run(arguments(page)) == 2
    err = capsys.readouterr().err
    assert why in err
    assert "secret" not in err


def test_a_page_that_is_not_there_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with serving(ID, b"") as page:
        url = page.url
    assert run(["fetch", "--url", url, "--to", str(tmp_path)]) == 3
    assert url in capsys.readouterr().err
