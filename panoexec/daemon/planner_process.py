"""The child process in which the daemon plans: a `PlanSpec` comes in, an `Outcome` goes out.

`main` reads the one from standard input and writes the other to standard output, both pickled, as both ends are this
very program. It imports the planner and neither pydantic nor asyncio, so that it starts quickly.

The process is bounded by the kernel, whatever the request: memory (RLIMIT_DATA), processor time (RLIMIT_CPU), and it is
the first that the kernel ends when the computer runs out of memory.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import pickle
import resource
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Final, Literal

from panoexec.errors import PanoexecError, PlanningError, UsageError
from panoexec.inputs.plan_spec import PlanSpec
from panoexec.planning.model import Plan

MEMORY_MB: Final = 300
"""Resident memory that the process never exceeds, 10^6 bytes."""
CPU_S: Final = 300
"""Processor time, after which planning is given up.

A search ends by itself at its budget, which is at most `panoexec.planning.search.budget.MOST_BUDGET_S`; what is left is
for ordering and certifying a plan of `MOST_IMAGES`.
"""
MOST_IMAGES: Final = 10_000

_NICE: Final = 5
_OOM_SCORE: Final = 900
_PR_SET_PDEATHSIG: Final = 1
_RESERVE_MB: Final = 16
"""For memory that was reserved before the bound was set and not touched yet: stacks, and buffers of libraries."""
_RELAX: Final = "ask for a smaller band, a shorter lens, less overlap or smaller tolerances"
_AFTER_S: Final = 5
"""Processor time in which the process must end after `CPU_S`, before the kernel ends it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """A plan, or why there is none: the kind of error, and its text."""

    plan: Plan | None = None
    kind: Literal["planning", "usage", "budget", ""] = ""
    text: str = ""


class _OutOfTimeError(BaseException):
    """The processor time is used up; not an `Exception`, so that no code of the planner handles it."""


def outcome_of(spec: PlanSpec) -> Outcome:
    """Plan; panoexec's own errors and exhausted budgets become part of the outcome."""
    try:
        plan = spec.plan()
    except PlanningError as error:
        outcome = Outcome(kind="planning", text=str(error))
    except UsageError as error:
        outcome = Outcome(kind="usage", text=str(error))
    except PanoexecError as error:
        outcome = Outcome(text=str(error))
    except MemoryError:
        outcome = Outcome(kind="budget", text=out_of_memory())
    except _OutOfTimeError:
        outcome = Outcome(kind="budget", text=out_of_time())
    else:
        outcome = Outcome(plan=plan)
        if len(plan.shots) > MOST_IMAGES:
            text = f"the plan has {len(plan.shots)} images, the daemon accepts {MOST_IMAGES}: {_RELAX}"
            outcome = Outcome(kind="budget", text=text)
    return outcome


def out_of_memory() -> str:
    """The error for a plan that needs too much memory."""
    return f"planning needs more than {MEMORY_MB} MB of memory: {_RELAX}"


def out_of_time() -> str:
    """The error for a plan that takes too long."""
    return f"planning took more than {CPU_S} s of processor time: {_RELAX}"


def main() -> None:
    """Run the process: read, plan, write."""
    with contextlib.suppress(OSError, AttributeError):  # if the parent is killed, nobody needs the plan any more
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    give_way()
    limit_time(CPU_S)
    limit_memory(MEMORY_MB)
    try:
        spec = pickle.loads(sys.stdin.buffer.read())  # noqa: S301  (from our own parent)
        outcome = pickle.dumps(outcome_of(spec))
    except MemoryError:
        outcome = pickle.dumps(Outcome(kind="budget", text=out_of_memory()))
    except _OutOfTimeError:  # on the way out of the planner
        outcome = pickle.dumps(Outcome(kind="budget", text=out_of_time()))
    signal.signal(signal.SIGXCPU, signal.SIG_IGN)
    sys.stdout.buffer.write(outcome)


def give_way() -> None:
    """Run behind the daemon, and be ended before it when the computer runs out of memory."""
    with contextlib.suppress(OSError):  # a sandbox may deny it
        os.nice(_NICE)
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(_OOM_SCORE), encoding="ascii")


def limit_time(cpu_s: int) -> None:
    """End the planner with an error after so much processor time, and the process some seconds later."""

    def over(_number: int, _frame: FrameType | None) -> None:
        raise _OutOfTimeError

    signal.signal(signal.SIGXCPU, over)
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + _AFTER_S))


def limit_memory(memory_mb: float) -> None:
    """Make allocations fail before the resident memory exceeds this.

    The kernel limits the size of private writable mappings (RLIMIT_DATA), of which not all is resident. What they may
    grow by is therefore what the resident memory may.
    """
    sizes = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines())
    resident, data = (1024 * int(sizes[name].split()[0]) for name in ("VmRSS", "VmData"))
    bound = data + int(1e6 * (memory_mb - _RESERVE_MB)) - resident
    resource.setrlimit(resource.RLIMIT_DATA, (bound, bound))
