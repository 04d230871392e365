"""Makes thumbnails in a process of its own at low priority: decoding a photo takes longer than a trigger may be late.

Reads one JSON object per line (`photo`, `thumbnail`) and writes one per line (`error`, "" for none). Exits at the end
of its standard input.
"""

from __future__ import annotations

import io
import json
import os
import signal
import sys
from pathlib import Path
from typing import Any, Final

from panoexec.errors import PanoexecError
from panoexec.files import write_atomically

MOST_BYTES: Final = 20_000
_LONGER_PX: Final = (480, 320, 200, 120)
_QUALITIES: Final = (80, 65, 50, 35)
_NICENESS: Final = 10


def thumbnail(photo: Path) -> bytes:
    """A JPEG of at most `MOST_BYTES`, upright.

    Raises:
        OSError, ValueError, SyntaxError: the photo cannot be decoded.
    """
    import PIL.Image  # noqa: PLC0415  (when there is a photo)
    import PIL.ImageOps  # noqa: PLC0415

    with PIL.Image.open(photo) as picture:
        picture.draft("RGB", (2 * _LONGER_PX[0], 2 * _LONGER_PX[0]))
        small: Any = PIL.ImageOps.exif_transpose(picture).convert("RGB")
    data = b""
    for longer in _LONGER_PX:
        small.thumbnail((longer, longer))
        for quality in _QUALITIES:
            out = io.BytesIO()
            small.save(out, "JPEG", quality=quality, optimize=True)
            data = out.getvalue()
            if len(data) <= MOST_BYTES:
                return data
    raise ValueError(f"no thumbnail of at most {MOST_BYTES} bytes can be made ({len(data)})")


def _work() -> None:
    os.nice(_NICENESS)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    for line in sys.stdin:
        job, problem = json.loads(line), ""
        try:
            path = Path(job["thumbnail"])
            path.parent.mkdir(exist_ok=True)
            write_atomically(path, thumbnail(Path(job["photo"])), sync=False)
        except (PanoexecError, OSError, ValueError, SyntaxError) as error:
            problem = str(error) or type(error).__name__
        print(json.dumps({"error": problem}), flush=True)


if __name__ == "__main__":
    _work()
