"""Connecting on the best terms that the broker grants: with retained messages and QoS 1 if it has them.

A broker without retained messages refuses a retained will: with the reason 0x9A in MQTT 5, by closing the connection
in MQTT 3.1.1; so does one whose highest QoS is 0, with 0x9B. The daemon and the doctor connect here.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

import aiomqtt

from panoexec.mqtt.client import BrokerClient, ConnectionClosedError

RETAIN_NOT_SUPPORTED: Final = 0x9A
QOS_NOT_SUPPORTED: Final = 0x9B
TAKEN_OVER: Final = 0x8E


@dataclass(frozen=True, slots=True, kw_only=True)
class Terms:
    """What messages to this broker may be.

    Attributes:
        retain: whether the broker keeps retained messages.
        qos: 1, or 0 if the broker has nothing higher.
    """

    retain: bool = True
    qos: int = 1

    def limitations(self) -> list[str]:
        """What is missing, and what follows, one sentence each."""
        out = []
        if not self.retain:
            out.append(
                "the broker does not keep retained messages: status, state and plan reach only those who are "
                "connected; they are repeated, and published again when a client sends `get`"
            )
        if not self.qos:
            out.append("the broker has no QoS above 0: messages that are under way when a connection is lost are lost")
        return out


BEST: Final = Terms()
_LOWER: Final = (Terms(retain=False), Terms(qos=0), Terms(retain=False, qos=0))

Maker: TypeAlias = Callable[[Terms], Awaitable[BrokerClient]]
"""Makes a client, not yet connected, whose will keeps to the terms."""


class Dialer:
    """Connects, again and again; keeps what it learned by trial.

    Attributes:
        terms: of the last connection.
    """

    def __init__(self, make: Maker, *, five: bool) -> None:
        """Describe the connections.

        Args:
            make: makes each client.
            five: whether with MQTT 5, where a broker gives reasons.
        """
        self.terms = BEST
        self._make = make
        self._five = five
        self._learned = BEST
        self._ended_at_retained = 0

    async def dial(self, stack: AsyncExitStack) -> BrokerClient:
        """Connect; the stack will disconnect.

        Raises:
            aiomqtt.MqttError: there is no connection on any terms.
            UsageError: a credential is wrong.
        """
        try:
            client, terms = await self._granted(stack, self._learned)
        except ConnectionClosedError:
            if self._five:
                raise
            if self._learned != BEST:
                self._learned = BEST  # perhaps it is another broker by now
                raise
            client, terms = await self._tried(stack)
        limits = client.limits
        self.terms = Terms(retain=terms.retain and limits.retain, qos=min(terms.qos, limits.max_qos))
        return client

    def greeted(self) -> None:
        """Note that the first message was acknowledged."""
        self._ended_at_retained = 0

    def ended_at_greeting(self) -> None:
        """Note that the connection ended at the first message, small and retained; twice in a row, try without."""
        if self._learned.retain and self.terms.retain:
            self._ended_at_retained += 1
            if self._ended_at_retained > 1:
                self._learned = replace(self._learned, retain=False)
        else:
            self._learned, self._ended_at_retained = BEST, 0  # that was not it

    async def _granted(self, stack: AsyncExitStack, terms: Terms) -> tuple[BrokerClient, Terms]:
        """Connect; lower the terms as the broker's reasons demand."""
        while True:
            client = await self._make(terms)
            try:
                return await stack.enter_async_context(client), terms
            except aiomqtt.MqttCodeError as error:
                code = getattr(error.rc, "value", error.rc)
                if code == RETAIN_NOT_SUPPORTED and terms.retain:
                    terms = replace(terms, retain=False)
                elif code == QOS_NOT_SUPPORTED and terms.qos:
                    terms = replace(terms, qos=0)
                else:
                    raise

    async def _tried(self, stack: AsyncExitStack) -> tuple[BrokerClient, Terms]:
        """Find out whether the connection is closed because of the will.

        A connection may also be closed by chance, so lower terms are believed only if the best ones fail once more
        after they have succeeded.
        """
        for terms in _LOWER:
            try:
                async with await self._make(terms):
                    pass
            except ConnectionClosedError:
                continue
            try:
                return await stack.enter_async_context(await self._make(BEST)), BEST
            except ConnectionClosedError:
                self._learned = terms
                return await stack.enter_async_context(await self._make(terms)), terms
        raise ConnectionClosedError
