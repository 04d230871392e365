"""Plans for requests: one computation at a time, one request per sender, missions first.

The planner's process is bounded (`panoexec.daemon.planner`), and there is one of them, so planning takes one bounded
share of memory and processor however many requests arrive.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Final

from panoexec.daemon.errors import SupersededError
from panoexec.daemon.planner import plan_apart
from panoexec.inputs.plan_spec import PlanSpec
from panoexec.mqtt.requests import RefusedRequestError
from panoexec.planning.model import Plan

MAX_SENDERS: Final = 8
"""Senders whose requests for a plan may wait at the same time."""

_KEPT_PLANS: Final = 8
_CALM_S: Final = 0.05
"""A computation begins so long after it is needed, so that a flood of requests does not start a process for each."""


@dataclass(slots=True, eq=False)
class _Waiting:
    """A request that waits for its plan; `sender` is None for a mission."""

    key: str
    spec: PlanSpec
    sender: str | None
    plan: asyncio.Future[Plan] = field(default_factory=lambda: asyncio.get_running_loop().create_future())


class PlanningDesk:
    """Computes plans; identical specifications are computed once."""

    def __init__(self) -> None:
        self._waiting: list[_Waiting] = []
        self._computing: tuple[str, asyncio.Task[None]] | None = None
        self._plans: OrderedDict[str, Plan] = OrderedDict()

    async def for_mission(self, spec: PlanSpec) -> Plan:
        """Compute the plan of a mission, before all plans that are only asked for.

        Raises:
            PlanningError: no plan can satisfy the constraints, or its computation exceeds the budget.
            PanoexecError: it failed otherwise.
        """
        return await self._wait(_Waiting(repr(spec), spec, None))

    async def for_sender(self, spec: PlanSpec, sender: str) -> Plan:
        """Compute a plan; it takes the place of one that the same sender waits for.

        Raises:
            SupersededError: the sender asked for a newer plan.
            RefusedRequestError: too many senders wait.
            PlanningError: no plan can satisfy the constraints, or its computation exceeds the budget.
            PanoexecError: it failed otherwise.
        """
        for other in self._waiting:
            if other.sender == sender and not other.plan.done():
                other.plan.set_exception(SupersededError("a newer plan request of this sender took its place"))
        if sum(one.sender is not None and not one.plan.done() for one in self._waiting) >= MAX_SENDERS:
            raise RefusedRequestError("overload", f"{MAX_SENDERS} senders wait for plans: ask again later")
        return await self._wait(_Waiting(repr(spec), spec, sender))

    async def _wait(self, one: _Waiting) -> Plan:
        known = self._plans.get(one.key)
        if known is not None:
            return known
        self._waiting.append(one)
        self._reconsider()
        try:
            return await one.plan
        finally:
            self._waiting.remove(one)
            one.plan.cancel()
            self._reconsider()
            if not self._waiting and self._computing is not None:
                # the planner's process ends before the last request that waited for it
                await asyncio.wait({self._computing[1]})

    def _reconsider(self) -> None:
        """Compute what is needed most, missions first; a computation that is not needed any more is cancelled."""
        waiting = [one for one in self._waiting if not one.plan.done()]
        needed = [one for one in waiting if one.sender is None] or waiting
        if self._computing is not None:
            key, task = self._computing
            if all(one.key != key for one in needed):
                task.cancel()
        elif needed:
            task = asyncio.create_task(self._compute(needed[0].key, needed[0].spec), name="plan")
            self._computing = needed[0].key, task
            task.add_done_callback(self._computed)

    async def _compute(self, key: str, spec: PlanSpec) -> None:
        try:
            await asyncio.sleep(_CALM_S)
            plan = await plan_apart(spec)
        except Exception as error:  # noqa: BLE001  (raised where it is waited for)
            for one in self._of(key):
                one.plan.set_exception(error)
            return
        self._plans[key] = plan
        while len(self._plans) > _KEPT_PLANS:
            self._plans.popitem(last=False)
        for one in self._of(key):
            one.plan.set_result(plan)

    def _computed(self, _task: asyncio.Task[None]) -> None:
        self._computing = None
        self._reconsider()

    def _of(self, key: str) -> list[_Waiting]:
        return [one for one in self._waiting if one.key == key and not one.plan.done()]
