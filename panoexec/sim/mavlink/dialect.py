"""The only import of pymavlink: MAVLink 2 with ArduPilot's dialect, selected before the import.

pymavlink reads `MAVLINK20` and `MAVLINK_DIALECT` when it is first imported; without them the gimbal messages of
protocol version 2 (280 to 288) do not exist.
"""

from __future__ import annotations

import os

from panoexec.errors import DependencyError, to_install

os.environ["MAVLINK20"] = "1"
os.environ["MAVLINK_DIALECT"] = "ardupilotmega"

try:
    from pymavlink.dialects.v20 import ardupilotmega as mavlink
except ImportError as error:
    raise DependencyError(f"the simulated vehicle needs pymavlink: {to_install('sim')}") from error

__all__ = ["mavlink"]
