"""`python -m panoexec` and the `panoexec` command."""

from __future__ import annotations

import os
import sys


def main() -> None:
    """Run the command line and exit with its code."""
    # before numpy is imported: its matrices are small here, and the threads of a busy machine wait for each other
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from panoexec.cli.app import run  # noqa: PLC0415  (keeps `import panoexec` light)

    if sys.platform == "win32":  # paho-mqtt's sockets are watched by readiness, which the default loop there cannot do
        import asyncio  # noqa: PLC0415

        asyncio.set_event_loop_policy(asyncio.WindowsSelectorEventLoopPolicy())
    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
