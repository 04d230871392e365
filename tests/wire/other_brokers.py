"""Brokers other than mosquitto, for opt-in tests: a NATS cluster and RabbitMQ. Nothing of them is installed here.

The programs are found on the PATH, or named by PANOEXEC_NATS_SERVER and PANOEXEC_RABBITMQ_SERVER.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from panoexec.sim.ports import free_tcp_port
from tests.wire.broker import PATH

NATS = os.environ.get("PANOEXEC_NATS_SERVER") or shutil.which("nats-server", path=PATH)
_RABBIT_PLACES = PATH + os.pathsep + "/usr/lib/rabbitmq/bin"
RABBIT = os.environ.get("PANOEXEC_RABBITMQ_SERVER") or shutil.which(
    "rabbitmq-server", path="/usr/lib/rabbitmq/bin" + os.pathsep + _RABBIT_PLACES
)
_START_S = 90.0


def wait_for_port(port: int, process: subprocess.Popen[bytes], log: Path) -> None:
    """Wait until somebody listens."""
    deadline = time.monotonic() + _START_S
    while time.monotonic() < deadline and process.poll() is None:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
            return
        time.sleep(0.1)
    raise AssertionError(f"no broker on port {port}: {log.read_text()[-2000:]}")


@contextmanager
def started(
    command: Sequence[str], log: Path, environment: Mapping[str, str] | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """A process while the block runs."""
    with log.open("ab") as out:
        process = subprocess.Popen(command, stdout=out, stderr=out, env=environment and dict(environment))
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(10)


@contextmanager
def nats_cluster(folder: Path, nodes: int = 3) -> Iterator[list[tuple[int, subprocess.Popen[bytes]]]]:
    """NATS servers with JetStream and MQTT: the MQTT port of each, and its process."""
    assert NATS is not None
    clients = [free_tcp_port() for _ in range(nodes)]
    routes = [free_tcp_port() for _ in range(nodes)]
    ports = [free_tcp_port() for _ in range(nodes)]
    all_routes = ", ".join(f'"nats://127.0.0.1:{port}"' for port in routes)
    with contextlib.ExitStack() as stack:
        out = []
        for number in range(nodes):
            config = folder / f"nats{number}.conf"
            config.write_text(
                f'server_name: n{number}\nlisten: "127.0.0.1:{clients[number]}"\n'
                f'jetstream {{ store_dir: "{folder}/jetstream{number}" }}\n'
                f'cluster {{ name: test, listen: "127.0.0.1:{routes[number]}", routes: [{all_routes}] }}\n'
                f'mqtt {{ listen: "127.0.0.1:{ports[number]}" }}\n'
            )
            log = folder / f"nats{number}.log"
            process = stack.enter_context(started([NATS, "-c", str(config)], log))
            out.append((ports[number], process))
        for number, (port, process) in enumerate(out):
            wait_for_port(port, process, folder / f"nats{number}.log")
        yield out


@contextmanager
def rabbitmq(folder: Path) -> Iterator[int]:
    """RabbitMQ with its MQTT plugin: the MQTT port."""
    assert RABBIT is not None
    port, amqp, distribution = free_tcp_port(), free_tcp_port(), free_tcp_port()
    (folder / "plugins").write_text("[rabbitmq_mqtt].\n")
    (folder / "rabbitmq.conf").write_text(
        f"mqtt.listeners.tcp.1 = 127.0.0.1:{port}\nmqtt.allow_anonymous = true\n"
        f"listeners.tcp.1 = 127.0.0.1:{amqp}\nlog.console = true\nlog.file = false\n"
    )
    environment = {
        "PATH": PATH,
        "HOME": str(folder),
        "LANG": "C.UTF-8",
        "RABBITMQ_NODENAME": f"panoexec{port}@localhost",
        "RABBITMQ_CONFIG_FILE": str(folder / "rabbitmq.conf"),
        "RABBITMQ_ENABLED_PLUGINS_FILE": str(folder / "plugins"),
        "RABBITMQ_MNESIA_BASE": str(folder / "mnesia"),
        "RABBITMQ_LOG_BASE": str(folder / "log"),
        "RABBITMQ_DIST_PORT": str(distribution),
    }
    log = folder / "rabbitmq.log"
    with started([RABBIT], log, environment) as process:
        wait_for_port(port, process, log)
        yield port
