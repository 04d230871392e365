"""Fly a panorama by MQTT: ask for the plan, start the mission, print its events until it ends.

    python examples/mqtt_client.py [BROKER [VEHICLE [PORT]]]

`panoexec simulate` and `panoexec serve` give it something to fly (docs/ground-station.md).
"""

import asyncio
import json
import sys
import uuid
from typing import Any

import aiomqtt

PANORAMA = {"overlap": 0.15, "elevation_deg": [-60, 10]}  # what is left out comes from the vehicle's configuration
ENDED = {"complete", "incomplete", "aborted", "failed"}


async def fly(broker: str = "127.0.0.1", vehicle: str = "drone", port: str = "1883") -> str:
    """Fly `PANORAMA` and return the mission's last state, or the error code of the request that was refused."""
    base = f"panoexec/{vehicle}"
    asked: dict[str, str] = {}  # command by transaction
    started = False
    async with aiomqtt.Client(broker, int(port)) as client:

        async def request(command: str, **fields: Any) -> None:
            asked[transaction := uuid.uuid4().hex] = command
            payload = json.dumps({"transaction": transaction, **fields})
            await client.publish(f"{base}/request/{command}", payload, qos=1)

        await client.subscribe([(f"{base}/{topic}", 1) for topic in ("status", "response/+", "event")])
        print(f"waiting for {base}/status")
        async for message in client.messages:
            if message.topic.matches(f"{base}/status"):
                if message.payload == b"online" and not started:
                    started = True
                    await request("plan", **PANORAMA)
                continue
            said = json.loads(bytes(message.payload))
            if message.topic.matches(f"{base}/event"):
                print(said["time"], said["type"], said.get("shot", ""), said.get("reason", ""))
                if said["state"] in ENDED:
                    return str(said["state"])
            elif (command := asked.pop(said["transaction"], None)) and said["status"] == "error":
                print(f"{command} refused:", said["error"]["message"])
                return str(said["error"]["code"])
            elif command == "plan":
                print(said["data"]["images"], "images,", round(said["data"]["duration_s"]), "s")
                await request("start", **PANORAMA)
            elif command == "start":
                print("mission", said["data"]["mission_id"])
    raise AssertionError("the messages never end")


if __name__ == "__main__":
    sys.exit(asyncio.run(fly(*sys.argv[1:])) != "complete")
