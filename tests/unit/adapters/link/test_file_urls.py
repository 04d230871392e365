"""Which files a camera may name."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from panoexec.adapters.link.file_urls import FileUrls, mavlink_ftp_component, mavlink_ftp_path
from panoexec.adapters.link.message_hub import MavMessage
from panoexec.inputs.config import Config


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    folder = tmp_path / "photos"
    folder.mkdir()
    (folder / "1.jpg").write_bytes(b"x")
    return folder


def test_files_below_a_folder_and_of_a_host_are_kept(photos: Path) -> None:
    urls = FileUrls(folders=(photos,), hosts=("Camera.local", "192.168.144.25"))
    kept = (
        (photos / "1.jpg").as_uri(),
        (photos / "later" / "2.jpg").as_uri(),
        f"file://localhost{photos}/1.jpg",
        "http://camera.local/1.jpg",
        "http://CAMERA.local:8080/DCIM/1.jpg",
        "ftp://192.168.144.25/1.dng",
    )
    for url in kept:
        assert urls.checked(url) == (url, ""), url


@pytest.mark.parametrize(
    ("url", "path", "component", "kept"),
    [
        ("mftp://[;comp=100]/DCIM/1.JPG", "/DCIM/1.JPG", 100, "mftp://;comp=100/DCIM/1.JPG"),
        ("mftp:///DCIM/a%20b.jpg", "/DCIM/a b.jpg", None, "mftp:///DCIM/a%20b.jpg"),
        ("mavlinkftp:///1.jpg", "/1.jpg", None, "mavlinkftp:///1.jpg"),
        ("FTP:///fs/1.jpg", "/fs/1.jpg", None, "FTP:///fs/1.jpg"),
    ],
)
def test_files_that_the_camera_serves_by_mavlink_are_kept(
    url: str, path: str, component: int | None, kept: str
) -> None:
    assert (mavlink_ftp_path(url), mavlink_ftp_component(url)) == (path, component)
    assert FileUrls().checked(url) == (kept, "")
    assert (mavlink_ftp_path(kept), mavlink_ftp_component(kept)) == (path, component)


@pytest.mark.parametrize("url", ["ftp://host/1.jpg", "mftp://host/1.jpg", "mftp:///DCIM/", "mftp:///%00/1.jpg", ""])
def test_other_files_are_not_asked_of_the_camera(url: str) -> None:
    assert not mavlink_ftp_path(url)
    assert FileUrls().checked(url)[0] in {"", "1.jpg"}


@pytest.mark.parametrize("name", ["", "IMG_1.jpg", "/DCIM/100MEDIA/DJI_0042.JPG", "DCIM/1.ARW", "C:\\DCIM\\1.JPG"])
def test_a_name_on_the_card_is_no_file_of_this_computer(name: str) -> None:
    assert FileUrls().checked(name) == (name, "")


@pytest.mark.parametrize(
    ("url", "kept"),
    [
        ("file:///etc/hostname", ""),
        ("file:/etc/hostname", ""),
        ("FILE:///etc/hostname", ""),
        ("file://localhost/etc/passwd", ""),
        ("file://elsewhere/{photos}/1.jpg", "1.jpg"),
        ("file:///mnt/card/DSC1.JPG", "DSC1.JPG"),
        ("file://{photos}/../secret.jpg", "secret.jpg"),
        ("file://{photos}/%2e%2e/%2e%2e/etc/shadow", ""),
        ("file://{photos}", ""),
        ("file://{photos}/%00/1.jpg", "1.jpg"),
        ("http://stranger/1.jpg", "1.jpg"),
        ("http://camera@stranger/1.jpg", "1.jpg"),
        ("http://camera.stranger/1.jpg", "1.jpg"),
        ("http://[::1/1.jpg", ""),
        ("sftp://elsewhere/fs/1.jpg", "1.jpg"),
        ("javascript:alert(1)", ""),
        ("http://camera/\n1.jpg", ""),
    ],
)
def test_everything_else_is_reduced_to_the_name_of_an_image(photos: Path, url: str, kept: str) -> None:
    found, why = FileUrls(folders=(photos,), hosts=("camera",)).checked(url.replace("{photos}", str(photos)))
    assert found == kept
    assert why


def test_a_link_out_of_the_folder_is_not_below_it(photos: Path, tmp_path: Path) -> None:
    (tmp_path / "secret.jpg").write_bytes(b"x")
    (photos / "link.jpg").symlink_to(tmp_path / "secret.jpg")
    assert FileUrls(folders=(photos,)).checked((photos / "link.jpg").as_uri())[0] == "link.jpg"
    shortcut = tmp_path / "shortcut"
    shortcut.symlink_to(photos)
    url = (photos / "1.jpg").as_uri()
    assert FileUrls(folders=(shortcut,)).checked(url) == (url, "")


def test_the_message_is_changed_and_the_reason_is_kept() -> None:
    urls = FileUrls()
    message = MavMessage("CAMERA_IMAGE_CAPTURED", 100, {"file_url": "file:///etc/hostname\0\0", "image_index": 3}, 0.0)
    urls.screen(message)
    assert message.fields == {"file_url": "", "image_index": 3}
    assert "file:///etc/hostname" in urls.refused
    assert "[camera] file_folders" in urls.refused


SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:")


@given(st.text())
@example(":")
@example(":0")
def test_whatever_a_camera_tells_names_no_unexpected_file(url: str) -> None:
    for told in (url, f"file://{url}", f"file:///{url}", f"http://{url}"):
        kept, why = FileUrls().checked(told)
        if kept != told:
            assert why
            assert "/" not in kept
        else:
            assert not SCHEME.match(told) or told[1] == ":"


def test_hosts_are_names_without_a_scheme() -> None:
    with pytest.raises(ValueError, match="is not a host"):
        Config.model_validate({"camera": {"file_hosts": ["http://camera"]}})
