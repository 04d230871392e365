"""Removes files when its parent has gone: `sweeper.py PATH…`, with a pipe from the parent as its input.

What a killed process leaves is nobody's otherwise: the kernel kills its autopilot (see `tether`), but a temporary
directory and PX4's lock file stay. Run by path in an interpreter of its own, with the standard library only.
"""

import os
import shutil
import stat
import sys
import time
from contextlib import suppress
from pathlib import Path

_LOOK_S = 0.1
_PATIENCE_S = 5.0


def main(paths: list[str]) -> None:
    """Return when the input has ended and none of the paths exists any more; or does so again and again."""
    os.read(0, 1)
    # a process that is just being killed may create a file anew, so one look is not enough
    end_s = time.monotonic() + _PATIENCE_S
    while sweep(paths) and time.monotonic() < end_s:
        time.sleep(_LOOK_S)


def sweep(paths: list[str]) -> bool:
    """Remove files and directories; returns whether there were any."""
    found = False
    for path in paths:
        with suppress(FileNotFoundError):
            kind = Path(path).lstat().st_mode
            found = True
            if stat.S_ISDIR(kind):
                shutil.rmtree(path, ignore_errors=True)
            else:
                Path(path).unlink()
    return found


if __name__ == "__main__":
    main(sys.argv[1:])
