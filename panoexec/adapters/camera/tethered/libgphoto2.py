"""What is asked of libgphoto2, for the process that holds the camera. Blocking; imports nothing else of panoexec.

Sources: libgphoto2 2.5.34 (gphoto2-camera.h, gphoto2-result.h, gphoto2-filesys.h), its camera library ptp2.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import gphoto2 as gp

CHUNK: Final = 1 << 18
"""Bytes that are read at once, between which a trigger can be sent: 10 ms at 25 MB/s."""
LARGEST: Final = 256 << 20
"""Largest file that is fetched, bytes."""
_NETWORK_MODEL: Final = "PTP/IP Camera"
_READ_ONLY: Final = 1
_DEPTH: Final = 8
_JPEGS: Final = frozenset({".jpg", ".jpeg", ".jpe"})
_KINDS: Final = {
    gp.GP_WIDGET_RADIO: "choice",
    gp.GP_WIDGET_MENU: "choice",
    gp.GP_WIDGET_TOGGLE: "toggle",
    gp.GP_WIDGET_RANGE: "range",
    gp.GP_WIDGET_TEXT: "text",
}


class CameraError(Exception):
    """What failed.

    Attributes:
        kind: `none`, `several`, `model`, `claimed`, `refused`, `lost`, `file` or `setting`.
        code: libgphoto2's result code, 0 if it was none of its errors.
    """

    def __init__(self, kind: str, text: str, code: int = 0) -> None:
        super().__init__(text)
        self.kind = kind
        self.code = code


_GONE: Final = frozenset(
    {
        gp.GP_ERROR_IO,
        gp.GP_ERROR_TIMEOUT,
        gp.GP_ERROR_IO_INIT,
        gp.GP_ERROR_IO_READ,
        gp.GP_ERROR_IO_WRITE,
        gp.GP_ERROR_IO_UPDATE,
        gp.GP_ERROR_IO_USB_CLEAR_HALT,
        gp.GP_ERROR_IO_USB_FIND,
        gp.GP_ERROR_IO_USB_CLAIM,
        gp.GP_ERROR_MODEL_NOT_FOUND,
        gp.GP_ERROR_UNKNOWN_PORT,
    }
)
"""Results after which the camera has to be opened anew."""


@contextlib.contextmanager
def _calls(what: str, kind: str = "refused") -> Iterator[None]:
    """Turn libgphoto2's errors into `CameraError`."""
    try:
        yield
    except gp.GPhoto2Error as error:
        found = "lost" if error.code in _GONE else kind
        raise CameraError(found, f"{what}: {error.string} ({error.code})", error.code) from error


class Library:
    """One camera, opened by port and model."""

    def __init__(self) -> None:
        self._camera: Any = None
        self._partial = True

    def open(self, port: str, model: str) -> dict[str, Any]:
        """Open a camera.

        Args:
            port: `usb:…`, `ptpip:HOST`, or "" for the only camera on USB.
            model: as libgphoto2 names it, or a part of it; "" for any.

        Returns:
            `model`, `port`, `serial`, `library` and `partial`.

        Raises:
            CameraError: no camera, several, another model, or it cannot be opened.
        """
        port, name = self._choose(port, model)
        ports = gp.PortInfoList()
        ports.load()
        abilities = gp.CameraAbilitiesList()
        abilities.load()
        camera = gp.Camera()
        with _calls(port, "none"):
            camera.set_port_info(ports.get_info(ports.lookup_path(port)))
        with _calls(name, "none"):
            camera.set_abilities(abilities.get_abilities(abilities.lookup_model(name)))
        try:
            camera.init()
        except gp.GPhoto2Error as error:
            if error.code == gp.GP_ERROR_IO_USB_CLAIM:
                raise CameraError("claimed", f"{name} on {port}: {error.string}", error.code) from error
            raise CameraError("lost", f"{name} on {port}: {error.string} ({error.code})", error.code) from error
        self._camera = camera
        self._partial = True
        told = self.read(["cameramodel", "manufacturer", "serialnumber"])
        if name == _NETWORK_MODEL:
            name = " ".join(told[key]["value"] for key in ("manufacturer", "cameramodel") if key in told) or name
            if model and model.lower() not in name.lower():
                self.close()
                raise CameraError("model", f"{name} on {port}")
        serial = told.get("serialnumber", {}).get("value", "")
        return {"model": name, "port": port, "serial": serial, "library": gp.gp_library_version(0)[0]}

    def _choose(self, port: str, model: str) -> tuple[str, str]:
        """Port and model of the camera that is meant."""
        if port.startswith("ptpip:"):
            return port, _NETWORK_MODEL
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            with _calls("looking for cameras"):
                found = gp.Camera.autodetect()
        cameras = [(found.get_value(index), found.get_name(index)) for index in range(found.count())]
        if not cameras:
            raise CameraError("none", "")
        listed = "; ".join(f"{name} on {where}" for where, name in cameras)
        fitting = [one for one in cameras if model.lower() in one[1].lower()]
        if not fitting:
            raise CameraError("model", listed)
        at_port = [one for one in fitting if port in {"", "usb:", one[0]}]
        if not at_port:
            raise CameraError("none", listed)
        if len(at_port) > 1:
            raise CameraError("several", listed)
        return at_port[0]

    def close(self) -> None:
        """Close the camera; does not raise."""
        camera, self._camera = self._camera, None
        if camera is not None:
            with contextlib.suppress(gp.GPhoto2Error):
                camera.exit()

    def trigger(self) -> float:
        """Release the shutter; returns when that was sent, seconds of CLOCK_MONOTONIC.

        Raises:
            CameraError: refused, or the camera is gone.
        """
        at_s = time.monotonic()
        try:
            with _calls("taking a photo"):
                self._camera.trigger_capture()
        except CameraError as error:
            if error.code == gp.GP_ERROR:  # which a cut connection causes, and a full card
                self._check_alive()
                why = _card_problem(self.storage())
                if why:
                    raise CameraError("refused", f"taking a photo: {why}", error.code) from error
            raise
        return at_s

    def _check_alive(self) -> None:
        """Ask for something that every camera answers.

        Raises:
            CameraError: `lost`: it does not.
        """
        with _calls("asking for the card", "lost"):
            self._camera.get_storageinfo()

    def event(self, wait_ms: int) -> dict[str, Any] | None:
        """The next event; None if there is none, or one that nobody needs.

        Raises:
            CameraError: the camera is gone.
        """
        with _calls("waiting for the camera", "lost"):
            kind, data = self._camera.wait_for_event(wait_ms)
        if kind == gp.GP_EVENT_FILE_ADDED:
            return {"event": "added", "folder": data.folder, "name": data.name, "at": time.monotonic()}
        if kind == gp.GP_EVENT_CAPTURE_COMPLETE:
            return {"event": "complete", "at": time.monotonic()}
        return None if kind == gp.GP_EVENT_TIMEOUT else {"event": "other", "at": time.monotonic()}

    def files_anew(self) -> list[tuple[str, str]]:
        """The same as `files`, as the camera has them now: libgphoto2 lists what it was told of by events.

        Raises:
            CameraError: the camera is gone.
        """
        with _calls("opening the camera again", "lost"):
            self._camera.exit()
            guard_standard_input()
            self._camera.init()
        return self.files()

    def files(self) -> list[tuple[str, str]]:
        """Folder and name of every file in the camera, in the order in which it lists them.

        Raises:
            CameraError: the camera is gone.
        """
        out: list[tuple[str, str]] = []
        self._list("/", out, _DEPTH)
        return out

    def _list(self, folder: str, out: list[tuple[str, str]], depth: int) -> None:
        with _calls(f"listing {folder}"):
            names = self._camera.folder_list_files(folder)
            folders = self._camera.folder_list_folders(folder)
        out += [(folder, names.get_name(index)) for index in range(names.count())]
        if depth:
            for index in range(folders.count()):
                self._list(f"{folder.rstrip('/')}/{folders.get_name(index)}", out, depth - 1)

    def fetch(self, folder: str, name: str, to: Path) -> Iterator[dict[str, Any] | None]:
        """Copy a file to this computer, in steps between which other calls may be made.

        Args:
            folder: in the camera.
            name: in the folder.
            to: where it goes, whole and on disk, or not at all.

        Yields:
            None after each step, at last `size`, `sha256`, `mtime` (the camera's clock) and `seconds`.

        Raises:
            CameraError: `file`: too large, empty or cut short; `lost`: the camera is gone.
        """
        began_s = time.monotonic()
        with _calls(f"{folder}/{name}", "file"):
            info = self._camera.file_get_info(folder, name).file
        size = int(info.size)
        if not 0 < size <= LARGEST:
            limit = f"at most {LARGEST >> 20} MiB are fetched" if size else "it is empty"
            raise CameraError("file", f"{folder}/{name} has {size} bytes: {limit}")
        digest, part = hashlib.sha256(), to.with_name(f".{to.name}.part")
        try:
            with part.open("wb") as file:
                done = 0
                for chunk in self._chunks(folder, name, size):
                    file.write(chunk)
                    digest.update(chunk)
                    done += len(chunk)
                    yield None
                if done != size:
                    raise CameraError("file", f"{folder}/{name} has {size} bytes, {done} arrived")
                file.flush()
                os.fsync(file.fileno())
            _check_whole(part, name)
            part.replace(to)
        except OSError as error:
            raise CameraError("file", f"{to}: {error.strerror}") from error
        finally:
            part.unlink(missing_ok=True)
        seconds = time.monotonic() - began_s
        yield {"size": size, "sha256": digest.hexdigest(), "mtime": int(info.mtime), "seconds": seconds}

    def _chunks(self, folder: str, name: str, size: int) -> Iterator[bytes]:
        """The content, in parts where the camera offers them."""
        offset, buffer = 0, bytearray(CHUNK)
        while self._partial and offset < size:
            try:
                count = int(self._camera.file_read(folder, name, gp.GP_FILE_TYPE_NORMAL, offset, buffer))
            except gp.GPhoto2Error as error:
                if error.code != gp.GP_ERROR_NOT_SUPPORTED or offset:
                    with _calls(f"{folder}/{name}", "file"):
                        raise
                self._partial = False
                break
            if not count:
                return
            offset += count
            yield bytes(memoryview(buffer)[:count])
        if not self._partial:
            with _calls(f"{folder}/{name}", "file"):
                found = self._camera.file_get(folder, name, gp.GP_FILE_TYPE_NORMAL)
                whole = memoryview(found.get_data_and_size())
            for start in range(0, len(whole), CHUNK):
                yield bytes(whole[start : start + CHUNK])

    def storage(self) -> list[dict[str, Any]]:
        """The camera's cards: `free_images` (-1 if untold), `free_kb` (-1 if untold), `read_only`.

        Raises:
            CameraError: the camera is gone.
        """
        try:
            with _calls("asking for the card"):
                found = self._camera.get_storageinfo()
        except CameraError as error:
            if error.kind == "lost":
                raise
            return []
        out = []
        for one in found:
            images = int(one.freeimages) if one.fields & gp.GP_STORAGEINFO_FREESPACEIMAGES else -1
            free_kb = int(one.freekbytes) if one.fields & gp.GP_STORAGEINFO_FREESPACEKBYTES else -1
            read_only = bool(one.fields & gp.GP_STORAGEINFO_ACCESS) and int(one.access) == _READ_ONLY
            out.append({"free_images": images, "free_kb": free_kb, "read_only": read_only})
        return out

    def read(self, names: list[str]) -> dict[str, dict[str, Any]]:
        """Settings by the names of their widgets: `value`, `choices`, `kind`, `read_only`; unknown ones are left out.

        Raises:
            CameraError: the camera is gone.
        """
        out: dict[str, dict[str, Any]] = {}
        for name in names:
            try:
                with _calls(name, "setting"):
                    widget = self._camera.get_single_config(name)
                    out[name] = _described(widget)
            except CameraError as error:
                if error.kind == "lost" and error.code != gp.GP_ERROR_IO_READ:
                    raise
        return out

    def set(self, name: str, value: Any) -> dict[str, Any]:
        """Change a setting; returns it as read back.

        Raises:
            CameraError: `setting`: refused; `lost`: the camera is gone.
        """
        with _calls(f"setting {name} to {value}", "setting"):
            widget = self._camera.get_single_config(name)
            widget.set_value(value)
            self._camera.set_single_config(name, widget)
        return self.read([name]).get(name, {})


def _card_problem(cards: list[dict[str, Any]]) -> str:
    """Why the card takes no photo; "" if nothing is known of that."""
    if not cards:
        return "the camera has no card"
    if all(one["read_only"] for one in cards):
        return "its card is write-protected"
    return "its card is full" if all(one["free_images"] == 0 for one in cards) else ""


def guard_standard_input() -> None:
    """Have /dev/null as file descriptor 0: leaving a camera on a network, libgphoto2 closes it (measured)."""
    try:
        os.fstat(0)
    except OSError:
        os.open(os.devnull, os.O_RDONLY)  # the lowest free one


def _described(widget: Any) -> dict[str, Any]:
    kind = _KINDS.get(widget.get_type(), "other")
    choices: list[str] = []
    if kind == "choice":
        choices = [str(widget.get_choice(index)) for index in range(widget.count_choices())]
    value = widget.get_value()
    return {
        "value": value if isinstance(value, int | float) else str(value),
        "choices": choices,
        "kind": kind,
        "read_only": bool(widget.get_readonly()),
    }


def _check_whole(path: Path, name: str) -> None:
    """Refuse a JPEG that does not begin like one, or has no end."""
    if Path(name).suffix.lower() not in _JPEGS:
        return
    with path.open("rb") as file:
        head = file.read(3)
        file.seek(0, os.SEEK_END)
        file.seek(max(0, file.tell() - (64 << 10)))
        tail = file.read()
    if head != b"\xff\xd8\xff":
        raise CameraError("file", f"{name} is not a JPEG")
    if b"\xff\xd9" not in tail:
        raise CameraError("file", f"{name} is cut short: it has no end")
