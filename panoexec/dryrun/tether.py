"""Executes a program that the kernel kills when its parent dies: `tether.py PARENT_PID PROGRAM [ARGUMENT…]`.

Run by path in an interpreter of its own, with the standard library only, so that it starts within some 20 ms. The
parent-death signal (`PR_SET_PDEATHSIG`) survives exec, and SIGKILL cannot be handled by the program.
"""

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1
CANNOT_RUN = 126
"""Exit code, as in a shell, when the program cannot be executed."""


def main(argv: list[str]) -> int:
    """Does not return on success."""
    parent, program = int(argv[0]), argv[1:]
    if ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        print(f"{program[0]}: {os.strerror(ctypes.get_errno())}", file=sys.stderr)
        return CANNOT_RUN
    if os.getppid() != parent:  # the parent died before prctl
        return CANNOT_RUN
    try:
        os.execv(program[0], program)  # noqa: S606  (no shell is wanted)
    except OSError as error:
        print(f"{program[0]}: {error.strerror}", file=sys.stderr)
    return CANNOT_RUN


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
