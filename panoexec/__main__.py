"""`python -m panoexec` and the `panoexec` command."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command line and exit with its code."""
    from panoexec.cli.app import run  # noqa: PLC0415  (keeps `import panoexec` light)

    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
