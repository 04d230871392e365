"""The missions of the server's computer: listed, downloaded whole or in parts, deleted when they are finished."""

# ruff: noqa: SIM117  (what is open inside of what is easier to see)
from __future__ import annotations

import asyncio
import io
import json
import shutil
import zipfile
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import aiohttp
import pytest

from panoexec.cli.app import run
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.store.journal import SqliteJournal
from panoexec.store.journal_layout import MISSION_ID
from panoexec.web.server import Server
from panoexec.web.users import new_user, write_users
from tests.support.web import base, browser, web_server
from tests.wire.broker import Broker, needs_mosquitto, running_broker

pytestmark = needs_mosquitto
RECORDED = Path(__file__).parents[1] / "data" / "recorded"
DONE = "20261130T063803.046Z"
BEGUN = "20261201T063803.046Z"


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with running_broker(tmp_path, verbose=False) as one:
        yield one


@pytest.fixture
async def storage(tmp_path: Path) -> Path:
    """One finished mission with a photo, a report and a stitched panorama, and one that can be resumed."""
    storage = tmp_path / "storage"
    done = storage / "missions" / DONE
    shutil.copytree(RECORDED, done)
    (done / "images").mkdir()
    (done / "images" / "IMG_00001.jpg").write_bytes(b"\xff\xd8photo" * 1000)
    (done / "images" / "secret.jpg").write_bytes(b"not of the manifest")
    (done / "report.html").write_text("<!doctype html><title>report</title>", encoding="utf-8")
    (done / "stitch").mkdir()
    (done / "stitch" / "panorama.jpg").write_bytes(b"\xff\xd8preview")
    (done / "stitch" / "panorama.tif").write_bytes(b"II*\x00whole" * 100)
    begun = storage / "missions" / BEGUN
    begun.mkdir()
    journal = await SqliteJournal.create(begun / "journal.sqlite", {MISSION_ID: BEGUN, "plan": "{}", "settings": "{}"})
    started = ev.MissionStarted(mission_id=BEGUN, seq=1, time_utc_s=1e9, state=MissionState.PREFLIGHT, shots_total=1)
    await journal.append([started])
    await journal.close()
    return storage


@pytest.fixture
async def server(broker: Broker, storage: Path) -> AsyncIterator[Server]:
    async with web_server(broker.port, storage=storage) as one:
        yield one


@pytest.fixture
async def session(server: Server) -> AsyncIterator[aiohttp.ClientSession]:
    async with aiohttp.ClientSession(base(server), headers={"Origin": base(server)}) as one:
        yield one


async def test_missions_are_listed_newest_first_without_a_path(
    server: Server, session: aiohttp.ClientSession, storage: Path
) -> None:
    async with session.get("/api/missions") as answer:
        told = await answer.text()
        listed = json.loads(told)
    assert str(storage) not in told
    assert listed["storage"]
    begun, done = listed["missions"]
    assert (begun["mission_id"], done["mission_id"]) == (BEGUN, DONE)
    assert (done["state"], done["shots_done"], done["photos"]) == ("complete", 18, 1)
    assert done["place"]["latitude_deg"] == pytest.approx(47.4, abs=0.1)
    assert done["deletable"] == ""
    assert "preflight" in begun["deletable"]
    assert begun["report"] is None
    journal = await SqliteJournal.open(storage / "missions" / BEGUN / "journal.sqlite")
    passed = ev.PreflightPassed(mission_id=BEGUN, seq=2, time_utc_s=1e9, state=MissionState.CAPTURING)
    await journal.append([passed])
    server._library._listed_s = 0.0  # it is 3 s later
    async with session.get("/api/missions") as answer:
        assert (await answer.json())["missions"][0]["state"] == "under way"
    await journal.close()
    for name in ("report", "panorama", "preview", "download"):
        async with session.get(done[name]) as answer:
            assert answer.status == 200, name
    async with session.get(done["report"]) as answer:
        assert answer.headers["Content-Security-Policy"].startswith("sandbox allow-scripts")
        assert "allow-same-origin" not in answer.headers["Content-Security-Policy"]
    async with session.get(done["panorama"], headers={"Range": "bytes=4-8"}) as answer:
        assert (answer.status, await answer.read()) == (206, b"whole")


async def test_only_photos_that_the_manifest_names_are_served(session: aiohttp.ClientSession, storage: Path) -> None:
    async with session.get(f"/missions/{DONE}/images/IMG_00001.jpg") as answer:
        assert answer.status == 200
        assert (await answer.read()).startswith(b"\xff\xd8photo")
    (storage / "missions" / DONE / "images" / "IMG_00002.jpg").symlink_to("/etc/passwd")
    for path in (
        f"/missions/{DONE}/images/secret.jpg",
        f"/missions/{DONE}/images/IMG_00002.jpg",
        f"/missions/{DONE}/images/..%2fmanifest.json",
        f"/missions/{DONE}/images/%2e%2e/%2e%2e/{BEGUN}/journal.sqlite",
        f"/missions/{BEGUN}/report",
        "/missions/20200101T000000.000Z/report",
        "/missions/..%2f..%2f/download",
    ):
        async with session.get(path) as answer:
            assert answer.status == 404, path


async def test_a_report_in_its_sandbox_opens_photos_and_nothing_else(
    broker: Broker, storage: Path, tmp_path: Path
) -> None:
    """Browsers send it no cookie that is SameSite=Strict."""
    users = tmp_path / "users"
    write_users(users, {"anna": new_user("anna", "operator", "correct horse")})
    async with web_server(broker.port, storage=storage, users_file=users) as server:
        headers, form = {"Origin": base(server)}, {"name": "anna", "password": "correct horse"}
        async with aiohttp.ClientSession(base(server), headers=headers) as session:
            async with session.post("/login", data=form, allow_redirects=False) as answer:
                photos = answer.cookies["panoexec_photos"]
                strict = answer.cookies["panoexec_session"]
        assert (photos["samesite"], photos["httponly"], photos["path"]) == ("Lax", True, "/missions")
        only = {"Cookie": f"panoexec_photos={photos.value}"}
        async with aiohttp.ClientSession(base(server), headers=headers | only) as session:
            async with session.get(f"/missions/{DONE}/images/IMG_00001.jpg") as answer:
                assert answer.status == 200
            for path in ("/api/missions", f"/missions/{DONE}/download", f"/missions/{DONE}/report", "/socket"):
                async with session.get(path) as answer:
                    assert answer.status == 401, path
            async with session.delete(f"/missions/{DONE}", headers={"X-Confirm": DONE}) as answer:
                assert answer.status == 401
        wrong = {"Cookie": f"panoexec_photos={strict.value}; panoexec_session={photos.value}"}
        async with aiohttp.ClientSession(base(server), headers=headers | wrong) as session:
            async with session.get(f"/missions/{DONE}/images/IMG_00001.jpg") as answer:
                assert answer.status == 401
        both = {"Cookie": f"panoexec_session={strict.value}"}
        async with aiohttp.ClientSession(base(server), headers=headers | both) as session:
            async with session.post("/logout", allow_redirects=False) as answer:
                assert answer.status == 303
        async with aiohttp.ClientSession(base(server), headers=headers | only) as session:
            async with session.get(f"/missions/{DONE}/images/IMG_00001.jpg") as answer:
                assert answer.status == 401, "it ends with the session"


async def test_a_download_is_resumed_where_it_broke_off(session: aiohttp.ClientSession, storage: Path) -> None:
    url = f"/missions/{DONE}/download"
    async with session.get(url) as answer:
        whole, tag = await answer.read(), answer.headers["ETag"]
        assert int(answer.headers["Content-Length"]) == len(whole)
        assert DONE in answer.headers["Content-Disposition"]
    with zipfile.ZipFile(io.BytesIO(whole)) as archive:
        assert archive.testzip() is None
        assert f"{DONE}/images/IMG_00001.jpg" in archive.namelist()
    half = len(whole) // 2
    async with session.get(url, headers={"Range": f"bytes={half}-", "If-Range": tag}) as answer:
        assert answer.status == 206
        assert answer.headers["Content-Range"] == f"bytes {half}-{len(whole) - 1}/{len(whole)}"
        assert whole[:half] + await answer.read() == whole
    async with session.head(url) as answer:
        assert (answer.status, int(answer.headers["Content-Length"])) == (200, len(whole))
    async with session.get(url, headers={"Range": f"bytes={len(whole)}-"}) as answer:
        assert answer.status == 416
    (storage / "missions" / DONE / "later.txt").write_text("x", encoding="utf-8")
    async with session.get(url, headers={"Range": f"bytes={half}-", "If-Range": tag}) as answer:
        assert answer.status == 200, "another archive is sent from its beginning"


async def test_only_a_finished_mission_is_deleted_and_only_when_it_is_confirmed(
    server: Server, session: aiohttp.ClientSession, storage: Path
) -> None:
    missions = storage / "missions"
    async with session.delete(f"/missions/{DONE}") as answer:
        assert answer.status == 428
    async with session.delete(f"/missions/{DONE}", headers={"X-Confirm": BEGUN}) as answer:
        assert answer.status == 428
    async with session.delete(f"/missions/{DONE}", headers={"X-Confirm": DONE, "Origin": "http://evil"}) as answer:
        assert answer.status == 403
    async with session.delete(f"/missions/{BEGUN}", headers={"X-Confirm": BEGUN}) as answer:
        assert answer.status == 409
        assert "only finished missions" in (await answer.json())["error"]
    journal = await SqliteJournal.open(missions / DONE / "journal.sqlite")  # photos are added to it
    async with session.delete(f"/missions/{DONE}", headers={"X-Confirm": DONE}) as answer:
        assert answer.status == 409
        assert "in use" in (await answer.json())["error"]
    await journal.close()
    assert {path.name for path in missions.iterdir()} == {DONE, BEGUN}
    async with browser(server) as page:
        async with session.delete(f"/missions/{DONE}", headers={"X-Confirm": DONE}) as answer:
            assert answer.status == 204
        await page.until("library")
    assert {path.name for path in missions.iterdir()} == {BEGUN}


@pytest.mark.skipif(shutil.which("nona") is None, reason="Hugin's tools are not installed")
async def test_stitching_tells_its_end_to_everybody_and_why_it_failed(server: Server) -> None:
    async with browser(server, name="TABLET-1") as asking, browser(server) as other:
        await asking.say(type="stitch", mission_id=DONE)
        await asking.say(type="stitch", mission_id=DONE)
        assert "being stitched" in (await asking.until("problem"))["text"]
        begun = await other.until("stitch")
        assert (begun["stage"], begun["who"], begun["mission_id"]) == ("running", "TABLET-1", DONE)
        failed = await other.until("stitch", lambda one: one["stage"] != "running")
        assert failed["stage"] == "failed"  # its one photo is none
        assert failed["text"]
        await other.until("library")


async def test_on_the_ground_there_are_no_missions_and_the_page_says_so(broker: Broker) -> None:
    async with web_server(broker.port) as server, browser(server) as page:
        assert not (await page.until("hello"))["missions"]
        async with aiohttp.ClientSession(base(server)) as session, session.get("/api/missions") as answer:
            assert await answer.json() == {"storage": False, "missions": []}
        await page.say(type="stitch", mission_id=DONE)
        assert "no missions" in (await page.until("problem"))["text"]
        cameras = await page.until("cameras")
        assert any(camera["name"] == "dji-x5s-15mm" for camera in cameras["cameras"])


async def test_the_command_fetch_brings_a_mission_by_http(server: Server, storage: Path, tmp_path: Path) -> None:
    shutil.rmtree(storage / "missions" / BEGUN)
    here = tmp_path / "here"
    code = await asyncio.to_thread(run, ["fetch", "--url", base(server), "--to", str(here)])
    assert code == 0
    source = storage / "missions" / DONE
    files = {path.relative_to(source): path.read_bytes() for path in source.rglob("*") if path.is_file()}
    copy = here / DONE
    assert files == {path.relative_to(copy): path.read_bytes() for path in copy.rglob("*") if path.is_file()}
