"""The report's page: what it says of sound, poor and hostile missions, and that nothing in it can run."""

from __future__ import annotations

import html.parser
import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

from panoexec.angles import quaternion_from_rotation, rotation
from panoexec.errors import InputFileError, UsageError
from panoexec.report import write_report
from panoexec.report.page import embedded_json
from panoexec.store.directory import MissionDirectory
from tests.report_missions import edit, photographed, stamp

HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>&\u2028\"'{{style}}"


class Elements(html.parser.HTMLParser):
    """The tags of a page, and the text of its data block."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.data = ""
        self._in_data = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._in_data = ("id", "data") in attrs

    def handle_data(self, data: str) -> None:
        if self._in_data:
            self.data += data

    def handle_endtag(self, tag: str) -> None:
        self._in_data = False


def elements(directory: MissionDirectory) -> Elements:
    found = Elements()
    found.feed(directory.report.read_text(encoding="utf-8"))
    return found


def data_of(directory: MissionDirectory) -> dict[str, Any]:
    return dict(json.loads(elements(directory).data))


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is on the picture is tested elsewhere."""
    monkeypatch.setattr("panoexec.report.panorama.QUICK_WIDTH_PX", 256)


@pytest.fixture
def directory(tmp_path: Path) -> MissionDirectory:
    return photographed(tmp_path / "20260921T141300.000Z")


def test_a_sound_mission(directory: MissionDirectory) -> None:
    report = write_report(directory)
    assert (report.path, report.photos, report.problems, report.panorama) == (directory.report, 7, (), "quick")
    data = data_of(directory)
    assert data["mission"]["state"] == "complete"
    assert data["counts"] == {"shots_total": 7, "shots_done": 7, "attempts": 8, "retakes": 1, "missing": []}
    assert data["reasons"] == [["pointing", 1]]
    assert data["battery"]["samples"] == [[0, 0.95], [18, 0.9]]
    assert data["band"]["elevation"] == [-90, -4]
    assert data["photos"] == {"accepted": 7, "usable": 7, "problems": [], "absent": ""}
    assert data["shots"][1]["attempts"][0]["error"] == [2.0, 0.01, 0.1]
    assert data["shots"][3]["photo"]["href"] == "./images/IMG_0003.jpg"


def test_nothing_is_fetched_and_only_its_own_scripts_may_run(directory: MissionDirectory) -> None:
    write_report(directory)
    tags = elements(directory).tags
    assert not [(tag, attributes) for tag, attributes in tags if {"src", "href"} & set(attributes)]
    (policy,) = [a["content"] for tag, a in tags if tag == "meta" and "http-equiv" in a]
    assert policy is not None
    assert "default-src 'none'" in policy
    assert "http" not in policy
    assert "unsafe-eval" not in policy
    assert not re.search(r"script-src[^;]*unsafe", policy)


def test_texts_of_the_mission_stay_texts(directory: MissionDirectory) -> None:
    def spoil(document: dict[str, Any]) -> None:
        document |= {"mission_id": HOSTILE, "reason": HOSTILE, "state": HOSTILE, "warnings": [HOSTILE]}
        document["vehicle"] = {HOSTILE: HOSTILE}
        document["camera"]["name"] = HOSTILE
        document["shots"][0] |= {"file": "javascript:alert(1)", "reason": HOSTILE}
        document["shots"][1]["attempts"][0] |= {"reason": HOSTILE, "code": HOSTILE}
        document["shots"][2]["file"] = "../../../etc/passwd"

    write_report(directory)
    plain = [tag for tag, _ in elements(directory).tags]
    edit(directory, spoil)
    write_report(directory)
    assert [tag for tag, _ in elements(directory).tags] == plain
    data = data_of(directory)
    assert data["mission"]["id"] == data["mission"]["reason"] == HOSTILE
    assert [data["shots"][i]["photo"]["href"] for i in (0, 2)] == [None, None]


def test_a_file_name_is_an_address_only_of_its_file(directory: MissionDirectory) -> None:
    name = "images/a b#c?d%41&e'\"<f>.jpg"
    (directory.path / "images" / "IMG_0000.jpg").rename(directory.path / name)
    edit(directory, lambda document: document["shots"][0].update(file=name))
    write_report(directory)
    href = data_of(directory)["shots"][0]["photo"]["href"]
    assert href == "./images/a%20b%23c%3Fd%2541%26e%27%22%3Cf%3E.jpg"


@pytest.mark.parametrize("text", [HOSTILE, "<!--", "]]>", "\u2029", "normal"])
def test_embedded_json_holds_any_text(text: str) -> None:
    coded = embedded_json({text: [text]})
    assert not set("<>&\u2028\u2029") & set(coded)
    assert json.loads(coded) == {text: [text]}


def test_missing_and_truncated_photos_are_named(directory: MissionDirectory) -> None:
    (directory.path / "images" / "IMG_0005.jpg").unlink()
    path = directory.path / "images" / "IMG_0003.jpg"
    path.write_bytes(path.read_bytes()[:-500])
    report = write_report(directory)
    assert [(i, photo.name, photo.problem) for i, photo in report.problems] == [
        (3, "images/IMG_0003.jpg", "is truncated"),
        (5, "IMG_0005.jpg", "is missing"),
    ]
    told = data_of(directory)["photos"]
    assert [p["shot"] for p in told["problems"]] == [3], "one that is not here yet is not damaged"
    assert told["absent"] == report.absent
    assert report.absent.startswith("1 of 7 photos are still in the camera (shots 5): copy its card and run: ")
    assert report.panorama == "quick"


def test_photos_that_are_all_in_the_camera_are_told_in_one_line(directory: MissionDirectory) -> None:
    for path in directory.images.iterdir():
        path.unlink()
    report = write_report(directory)
    text = f"the photos are still in the camera: copy its card and run: panoexec import {directory.path} CARD"
    assert report.absent == text
    told = data_of(directory)["photos"]
    assert (told["absent"], told["problems"]) == (text, [])


def test_a_photo_that_cannot_be_decoded_is_left_out_of_the_picture(directory: MissionDirectory) -> None:
    path = directory.path / "images" / "IMG_0003.jpg"
    content = bytearray(path.read_bytes())
    start = content.index(b"\xff\xda")
    content[start + 2 : start + 40] = bytes(38)
    path.write_bytes(content)
    report = write_report(directory)
    assert data_of(directory)["panorama"]["left_out"] == ["images/IMG_0003.jpg"]
    assert report.panorama == "quick"


def test_a_mission_without_photos_without_a_plan_without_a_shot_tried(directory: MissionDirectory) -> None:
    directory.plan.unlink()

    def nothing(document: dict[str, Any]) -> None:
        for shot in document["shots"]:
            shot.update(attempts=[], accepted_attempt=None, status="pending", file="")
        document |= {"state": "failed", "certificate": None, "battery": []}

    edit(directory, nothing)
    report = write_report(directory)
    assert (report.photos, report.panorama, report.why_none) == (0, "", "there are no usable photos")
    assert [note.split(":")[0] for note in report.notes] == [
        "the plan's constraints are missing",
        "the journal's times are missing",
    ]
    data = data_of(directory)
    assert data["timeline"]["limit_s"] is None
    assert data["band"]["known"] is False


@pytest.mark.parametrize(
    "spoil",
    [
        lambda document: document.pop("shots"),
        lambda document: document.pop("camera"),
        lambda document: document["shots"][0].pop("target"),
        lambda document: document["shots"][0].update(attempts=7),
        lambda document: document["camera"].update(focal_length_mm=0),
        lambda document: document["shots"][0]["target"].update(quaternion=[1, "x"]),
        lambda document: document.update(battery=[{"time": "noon", "charge_frac": 1}]),
    ],
)
def test_a_damaged_manifest_is_named_and_no_page_is_written(directory: MissionDirectory, spoil: Any) -> None:
    edit(directory, spoil)
    with pytest.raises(InputFileError, match=r"manifest\.json: is damaged or incomplete"):
        write_report(directory)
    assert not directory.report.exists()


def test_a_folder_that_cannot_be_written(directory: MissionDirectory) -> None:
    directory.report.mkdir()
    with pytest.raises(UsageError, match=r"report\.html: cannot be written"):
        write_report(directory)


def test_pages_of_155_shots_stay_small(directory: MissionDirectory) -> None:
    """3 MB without the previews."""

    def many(document: dict[str, Any]) -> None:
        template = document["shots"][1]
        document["shots"] = []
        for index in range(155):
            pose = {"quaternion": quaternion_from_rotation(rotation(index * 7.0, -30.0)).tolist(), "pitch_deg": -30.0}
            target = pose | {"yaw_deg": index * 7.0, "roll_deg": 0.0}
            shot = json.loads(json.dumps(template)) | {"index": index, "target": target}
            for attempt in shot["attempts"]:
                attempt |= {"measured": target, "target": target, "started": stamp(4.0 * index + 2 * attempt["number"])}
                attempt["error_deg"] = dict.fromkeys(("pitch", "roll", "yaw"), math.pi / 100)
            document["shots"].append(shot)

    edit(directory, many)
    report = write_report(directory)
    page = directory.report.read_text(encoding="utf-8")
    picture = page.index('id="panorama-jpeg"')
    assert report.panorama == "quick"
    assert len(page) - (page.index("</script>", picture) - picture) < 1_000_000
    assert len(data_of(directory)["shots"]) == 155


def test_the_stitched_panorama_is_preferred(directory: MissionDirectory) -> None:
    import PIL.Image  # noqa: PLC0415

    work = directory.path / "stitch"
    work.mkdir()
    PIL.Image.new("RGB", (512, 256), "navy").save(work / "panorama.jpg")
    document = {"format": "panoexec.stitch/1", "preview": "panorama.jpg", "completeness": {"fraction": 0.9998}}
    (work / "stitch.json").write_text(json.dumps(document), encoding="utf-8")
    assert write_report(directory).panorama == "stitched"
    assert data_of(directory)["stitch"]["completeness"] == {"fraction": 0.9998}
    # a preview that was lost or damaged is none
    (work / "panorama.jpg").write_bytes(b"no picture")
    assert write_report(directory).panorama == "quick"
