"""Upload a QGroundControl plan to a vehicle that hovers, and start its mission.

    python examples/fly_plan.py examples/stations.plan [CONNECTION]

CONNECTION is a MAVSDK connection, udpin://0.0.0.0:14550 by default: the port that `panoexec simulate` sends to besides
that of the daemon. What it does is QGroundControl's Upload and Start Mission (docs/stations.md).
"""

import sys
import time

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.mission_raw import MissionRaw

FIND_S = 20.0
KNOWN_S = 3.0  # until MAVSDK knows which autopilot it is: ArduPilot's missions begin with home


def fly(plan: str, connection: str = "udpin://0.0.0.0:14550") -> int:
    """Upload and start; returns the number of items."""
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    mavsdk.add_any_connection(connection)
    system = mavsdk.first_autopilot(FIND_S)
    if system is None:
        raise SystemExit(f"no vehicle on {connection} within {FIND_S:g} s")
    time.sleep(KNOWN_S)
    mission = MissionRaw(system)
    items = mission.import_qgroundcontrol_mission(plan).mission_items
    mission.upload_mission(items)
    print(f"{len(items)} items uploaded; starting")
    mission.start_mission()
    return len(items)


if __name__ == "__main__":
    fly(*sys.argv[1:3])
