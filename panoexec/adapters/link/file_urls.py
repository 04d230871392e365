"""Which files a camera may name: those below configured folders, and those of configured hosts.

CAMERA_IMAGE_CAPTURED (263) names the photo's file by a URL. Whoever can send a message to the link could name any file
of this computer, which would then prove a photo, or have it ask any host. So a URL is kept only where the
configuration expects photos, or where the camera itself serves them over MAVLink (MAVLink FTP); of others nothing but
the name of an image file is kept, which tells the photo on the camera's card. Nothing is opened here. A path without a
scheme is a name on the card and never a file of this computer.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import Final
from urllib.parse import SplitResult, unquote, urlsplit

import structlog

from panoexec.adapters.link.message_hub import MavMessage

MESSAGE: Final = "CAMERA_IMAGE_CAPTURED"
_IMAGES: Final = frozenset(
    {
        *("jpg", "jpeg", "jpe", "png", "tif", "tiff", "heic", "heif", "webp", "bmp"),
        *("dng", "raw", "arw", "srf", "sr2", "cr2", "cr3", "crw", "nef", "nrw", "raf", "orf", "rw2", "pef", "srw"),
        *("3fr", "iiq"),
    }
)
_LOCAL: Final = frozenset({"", "localhost"})
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:", re.ASCII)

_MAVLINK_FTP: Final = re.compile(
    r"(?:mftp|mavlinkftp|ftp)://(?:\[?;comp=(?P<component>\d{1,3})\]?)?(?P<path>/.+)", re.ASCII | re.IGNORECASE
)

_ODD: Final = "it has characters that no file name has"

_log = structlog.get_logger(__name__)


class FileUrls:
    """Screens the file names in reports of photos.

    Attributes:
        refused: the last URL that was not kept, with the reason; "" if there was none.
    """

    def __init__(self, *, folders: Iterable[Path] = (), hosts: Iterable[str] = ()) -> None:
        """Describe what is expected.

        Args:
            folders: where photos of this computer may be.
            hosts: names or addresses of cameras that serve their photos.
        """
        self.refused = ""
        self._folders = tuple(folder.resolve() for folder in folders)
        self._hosts = frozenset(host.lower() for host in hosts)

    @property
    def hosts(self) -> frozenset[str]:
        """Names and addresses of cameras that serve files, lower case."""
        return self._hosts

    def screen(self, message: MavMessage) -> None:
        """Replace the URL of a report by what is kept of it; may be called in MAVSDK's thread.

        Raises:
            LookupError: the message has no URL.
        """
        told = str(message.fields["file_url"]).rstrip("\0")
        kept, why = self.checked(told)
        if why:
            news = f"the camera told {told!r}: {why}"
            if not self.refused:
                _log.warning("file of a photo not believed", problem=news)
            self.refused = news
        message.fields["file_url"] = kept

    def checked(self, url: str) -> tuple[str, str]:
        """What is kept of a URL, and why that is not all of it ("" if it is).

        Args:
            url: as told by the camera, or "".
        """
        if not url.isprintable():
            return "", _ODD
        if mavlink_ftp_path(url):
            return _without_brackets(url), ""
        if _SCHEME.match(url) is None or _is_drive(url):
            return url, ""
        try:
            parts = urlsplit(url)
        except ValueError:
            return "", "it is not a URL"
        return self._kept(url, parts)

    def _kept(self, url: str, parts: SplitResult) -> tuple[str, str]:
        why = self._objection(parts)
        name = PurePosixPath(unquote(parts.path).replace("\\", "/")).name
        if not why:
            return url, ""
        if name.isprintable() and name.rpartition(".")[2].lower() in _IMAGES:
            return name, f"{why}; only the name is kept"
        return "", f"{why}, and it is not the name of an image"

    def _objection(self, parts: SplitResult) -> str:
        """Why the file is not expected, "" if it is."""
        host, path = (parts.hostname or "").lower(), unquote(parts.path)
        if not path.isprintable():
            return _ODD
        if parts.scheme != "file":
            return "" if host in self._hosts else f"host {host!r} is not in [camera] file_hosts"
        local = host in _LOCAL and self._is_expected(path)
        return "" if local else "it is below no folder of [camera] file_folders"

    def _is_expected(self, path: str) -> bool:
        try:
            real = Path(path).resolve()
        except (OSError, ValueError, RuntimeError):
            return False
        return any(real != folder and real.is_relative_to(folder) for folder in self._folders)


def mavlink_ftp_path(url: str) -> str:
    """The path of a file that the camera itself serves by MAVLink FTP; "" if the URL is not one of those.

    Args:
        url: `mftp://[;comp=100]/DCIM/1.JPG` as MAVLink writes it, the component may be missing; or with `mavlinkftp`,
            or with `ftp` and no host.
    """
    found = _MAVLINK_FTP.fullmatch(url)
    path = "" if found is None else unquote(found["path"])
    return path if path.isprintable() and not path.endswith("/") else ""


def mavlink_ftp_component(url: str) -> int | None:
    """The component that a URL of MAVLink FTP names; None if it names none."""
    found = _MAVLINK_FTP.fullmatch(url)
    return int(found["component"]) if found is not None and found["component"] else None


def _without_brackets(url: str) -> str:
    """A URL of MAVLink FTP that can be split like others, in which brackets are for IPv6 addresses."""
    return url.replace("[;", ";", 1).replace("]/", "/", 1)


def _is_drive(url: str) -> bool:
    r"""Whether it begins with a drive letter, as in `C:\DCIM\1.JPG`."""
    return len(url) > 1 and url[1] == ":"
