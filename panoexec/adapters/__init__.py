"""Adapters to hardware: the only importers of `mavsdk` and `serial`; they implement the protocols of `devices`.

Types and errors of MAVSDK and pyserial do not leave this package. The binding is `mavsdk` 4 (native, with callbacks
from a thread of its own); `link.worker_calls` and `link.message_hub` say why its callbacks are bridged to the event
loop here and not by its `asyncio` wrappers.
"""
