"""A connection that is given up while its thread is still connecting leaves nothing in the loop, and no traceback."""

from __future__ import annotations

import asyncio
import os
import socket
import threading
from typing import Any

import pytest

from panoexec.inputs.service_sections import MqttSection
from panoexec.mqtt.client import broker_client


async def test_given_up_while_its_thread_connects() -> None:
    told: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: told.append(context))
    with socket.create_server(("127.0.0.1", 0)) as server:
        client = await broker_client(MqttSection(host="127.0.0.1", port=server.getsockname()[1]))
        paho: Any = client._client
        reached, given_up, over = threading.Event(), threading.Event(), threading.Event()
        call = paho.on_socket_register_write

        def held(*arguments: Any) -> None:
            reached.set()
            given_up.wait(30)
            call(*arguments)
            over.set()

        paho.on_socket_register_write = held
        connecting = asyncio.create_task(client.__aenter__())
        assert await asyncio.to_thread(reached.wait, 30)
        connecting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await connecting
        given_up.set()
        assert await asyncio.to_thread(over.wait, 30)
        for _ in range(5):  # what the thread has left to the loop
            await asyncio.sleep(0)
    assert told == []


async def test_a_socket_that_is_closed_before_the_loop_comes_to_it_is_not_registered() -> None:
    told: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: told.append(context))
    client: Any = await broker_client(MqttSection(host="127.0.0.1", port=1))
    one, other = socket.socketpair()
    with other:
        client._on_socket_open(None, None, one)
        client._on_socket_register_write(None, None, one)
        os.close(one.detach())
        for _ in range(5):
            await asyncio.sleep(0)
    client._misc_task.cancel()
    await asyncio.gather(client._misc_task, return_exceptions=True)
    assert told == []
