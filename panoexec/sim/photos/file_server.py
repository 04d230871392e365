"""The simulated camera's web server: its files at `http://127.0.0.1:PORT/DCIM/NAME`, whole or in ranges.

Threads of their own serve it, so that a slow reader never delays the simulation.
"""

from __future__ import annotations

import contextlib
import re
import threading
import time
from collections.abc import Iterator, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Final
from urllib.parse import unquote

_NAME = re.compile(r"/DCIM/([A-Za-z0-9_-]+\.[a-z]{3})")
_RANGE = re.compile(r"bytes=(\d+)-")
_CHUNK_BYTES: Final = 16 * 1024


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    folder: Path | None
    besides: Mapping[str, bytes]
    kb_s: float

    def do_GET(self) -> None:
        """Send a photo that has been written, or another file, from the byte that is asked for."""
        name = _NAME.fullmatch(unquote(self.path))
        data = self._content(name[1]) if name else b""
        if not data:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        tag, asked = f'"{len(data)}"', _RANGE.fullmatch(self.headers.get("Range", ""))
        start = int(asked[1]) if asked and self.headers.get("If-Range", tag) == tag else 0
        self.send_response(HTTPStatus.PARTIAL_CONTENT if start else HTTPStatus.OK)
        self.send_header("Content-Type", "text/xml" if self.path.endswith(".xml") else "image/jpeg")
        self.send_header("Content-Length", str(len(data) - start))
        self.send_header("ETag", tag)
        if start:
            self.send_header("Content-Range", f"bytes {start}-{len(data) - 1}/{len(data)}")
        self.end_headers()
        with contextlib.suppress(ConnectionError):
            for at in range(start, len(data), _CHUNK_BYTES):
                self.wfile.write(data[at : at + _CHUNK_BYTES])
                if self.kb_s:
                    time.sleep(_CHUNK_BYTES / 1000 / self.kb_s)

    def _content(self, name: str) -> bytes:
        if name in self.besides or self.folder is None:
            return self.besides.get(name, b"")
        try:
            return (self.folder / name).read_bytes() if name.endswith(".jpg") else b""
        except OSError:
            return b""

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002  (the library's name)
        """Say nothing."""


@contextlib.contextmanager
def serving_photos(
    folder: Path | None, *, kb_s: float = 0.0, besides: Mapping[str, bytes] | None = None
) -> Iterator[str]:
    """Serve the photos of a folder while the block runs; yields the URL of the folder.

    Args:
        folder: where the photos are written; None: nowhere.
        kb_s: rate of each answer, kB/s; 0: at once.
        besides: content of further files, by name.
    """
    handler = type("Handler", (_Handler,), {"folder": folder, "kb_s": kb_s, "besides": dict(besides or {})})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, name="camera's web server", daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/DCIM"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
