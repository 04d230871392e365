"""A process of its own for missions on disk: lists, deletes or stitches, so that the server stays small and responsive.

`list STORAGE` prints a JSON list, newest last. `delete STORAGE ID` prints why not, or nothing. `stitch STORAGE ID`
prints a JSON object a line: `step`, `fraction`, `text`; the last one has `done`.
"""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import stat
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from panoexec.errors import PanoexecError
from panoexec.mission.log.states import FINISHED
from panoexec.store.catalogue import glance
from panoexec.store.directory import MissionDirectory
from panoexec.store.journal import JournalInUseError, SqliteJournal
from panoexec.store.listing import list_missions
from panoexec.web.mission_files import preview_file, stitched_file
from panoexec.web.protocol import is_mission

_LEFT: Final = ".deleted-"
_NICE: Final = 10


def main(argv: list[str]) -> int:
    """Run one command; errors of panoexec are one line on standard error."""
    os.nice(_NICE)
    command, storage = argv[0], Path(argv[1])
    try:
        if command == "list":
            _print([_described(entry.document(), entry.path) for entry in list_missions(storage)])
        elif command == "delete":
            asyncio.run(_delete(_directory(storage, argv[2])))
        else:
            _stitch(_directory(storage, argv[2]))
    except PanoexecError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return error.exit_code
    return 0


def _described(document: dict[str, Any], folder: Path) -> dict[str, Any]:
    """An entry of the list with what the page shows beside it; its path stays here."""
    manifest = _json(folder / "manifest.json")
    position, times = _table(manifest.get("position")), _table(manifest.get("times"))
    place = None
    if all(isinstance(position.get(name), int | float) for name in ("latitude_deg", "longitude_deg")):
        place = {name: position[name] for name in ("latitude_deg", "longitude_deg")}
    try:
        glance(folder / "journal.sqlite")
    except JournalInUseError:
        if document["state"] not in FINISHED:  # else photos are added to it
            document |= {"state": "under way", "problem": ""}
    except PanoexecError:
        pass  # told as its problem
    extra = {
        "time": times.get("started"),
        "place": place,
        "finished": document["state"] in FINISHED,
        "report": (folder / "report.html").is_file(),
        "panorama": stitched_file(folder) is not None,
        "preview": preview_file(folder) is not None,
    }
    document["problem"] = document["problem"].replace(f"{folder}/", "").replace(str(folder), "")
    return {name: value for name, value in document.items() if name != "path"} | extra


def _directory(storage: Path, mission_id: str) -> MissionDirectory:
    path = storage / "missions" / mission_id
    if not is_mission(mission_id) or not stat.S_ISDIR(_mode(path)):
        raise PanoexecError(f"there is no mission {mission_id}")
    return MissionDirectory(path)


def _mode(path: Path) -> int:
    try:
        return path.lstat().st_mode
    except OSError:
        return 0


async def _delete(directory: MissionDirectory) -> None:
    """Delete a finished mission; what was left of an interrupted deletion goes, too."""
    missions = directory.path.parent
    for left in missions.glob(f"{_LEFT}*"):
        shutil.rmtree(left, ignore_errors=True)
    state = glance(directory.journal).state
    if state not in FINISHED:
        raise PanoexecError(f"only finished missions can be deleted: this one is {state.value}")
    gone = missions / f"{_LEFT}{directory.mission_id}"
    # while it is ours no process can resume it, or add photos to it
    journal = await SqliteJournal.open(directory.journal)
    try:
        directory.path.rename(gone)
    except OSError as error:
        raise PanoexecError(f"cannot be deleted: {error.strerror or error}") from error
    finally:
        await journal.close()
    shutil.rmtree(gone, ignore_errors=True)


def _stitch(directory: MissionDirectory) -> None:
    from panoexec.report import write_report  # noqa: PLC0415  (needs packages that a list does without)
    from panoexec.stitching.mission import load_mission  # noqa: PLC0415
    from panoexec.stitching.pipeline import STEPS, Stitcher, StitchOptions  # noqa: PLC0415

    def progress(step: str, fraction: float, text: str) -> None:
        whole = (STEPS.index(step) + max(0.0, min(1.0, fraction))) / len(STEPS)
        _print({"step": step, "fraction": round(whole, 3), "text": text})

    result = Stitcher(load_mission(directory.path), StitchOptions(), progress).run()
    write_report(directory)
    _print({"done": True, "completeness": result.to_json().get("completeness")})


def _json(path: Path) -> Mapping[str, Any]:
    try:
        return _table(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError):
        return {}


def _table(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _print(document: object) -> None:
    print(json.dumps(document, separators=(",", ":")), flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
