"""Archives that are made while they are sent: whole, from anywhere, and never of files that changed."""

from __future__ import annotations

import io
import random
import zipfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from panoexec.web.zip_stream import FolderChangedError, ZipStream, zip_stream


def a_folder(path: Path, sizes: dict[str, int]) -> dict[str, bytes]:
    noise = random.Random(1)
    contents = {name: noise.randbytes(size) for name, size in sizes.items()}
    for name, content in contents.items():
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(content)
    return contents


SIZES = {
    "manifest.json": 900,
    "empty": 0,
    "images/a.jpg": 300_000,
    "images/grüße €.jpg": 5,
    "stitch/panorama.tif": 70_000,
}


async def read(archive: ZipStream, start: int = 0, stop: int | None = None) -> bytes:
    stop = archive.size if stop is None else stop
    return b"".join([chunk async for chunk in archive.read(start, stop)])


async def test_an_archive_has_every_file_and_the_length_that_was_told(tmp_path: Path) -> None:
    contents = a_folder(tmp_path / "m", SIZES)
    (tmp_path / "m" / ".hidden").write_bytes(b"x")
    (tmp_path / "m" / "journal.sqlite-shm").write_bytes(b"x")
    (tmp_path / "m" / "link").symlink_to("/etc/passwd")
    (tmp_path / "m" / "folder").symlink_to("/etc")
    archive = zip_stream(tmp_path / "m", name="ID")
    whole = await read(archive)
    assert len(whole) == archive.size
    with zipfile.ZipFile(io.BytesIO(whole)) as opened:
        assert opened.testzip() is None
        assert {name: opened.read(name) for name in opened.namelist()} == {
            f"ID/{name}": content for name, content in contents.items()
        }


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
async def test_any_part_is_the_part_of_the_whole(tmp_path: Path, data: st.DataObject) -> None:
    folder = tmp_path / "m"
    if not folder.exists():
        a_folder(folder, SIZES)
    archive = zip_stream(folder, name="ID")
    whole = await read(archive)
    start = data.draw(st.integers(0, archive.size))
    stop = data.draw(st.integers(start, archive.size))
    fresh = zip_stream(folder, name="ID")  # another process would know no checksum
    assert fresh.etag == archive.etag
    assert await read(fresh, start, stop) == whole[start:stop]


async def test_a_file_that_changes_breaks_it_off_and_gives_another_tag(tmp_path: Path) -> None:
    a_folder(tmp_path / "m", SIZES)
    archive = zip_stream(tmp_path / "m", name="ID")
    (tmp_path / "m" / "images" / "a.jpg").write_bytes(b"shorter")
    with pytest.raises(FolderChangedError):
        await read(archive)
    assert zip_stream(tmp_path / "m", name="ID").etag != archive.etag
    (tmp_path / "m" / "images" / "a.jpg").unlink()
    with pytest.raises(FolderChangedError):
        await read(archive)


async def test_archives_above_4_gb_are_zip64(tmp_path: Path) -> None:
    with (tmp_path / "b").open("wb") as file:
        file.truncate(4 << 30)  # takes no room on the disk
    (tmp_path / "c").write_bytes(b"after it")
    archive = zip_stream(tmp_path, name="ID")
    archive.checksums[archive._entries[0].key] = 0  # is not read: that would take seconds
    whole = tmp_path.parent / f"{tmp_path.name}.zip"
    after = (4 << 30) + 60
    with whole.open("wb") as file:
        file.write(await read(archive, 0, 200))
        file.seek(after)
        file.write(await read(archive, after, archive.size))
    try:
        with zipfile.ZipFile(whole) as opened:
            sizes = [(info.filename, info.file_size) for info in opened.infolist()]
            assert sizes == [("ID/b", 4 << 30), ("ID/c", 8)]
            assert opened.read("ID/c") == b"after it"
    finally:
        whole.unlink()
