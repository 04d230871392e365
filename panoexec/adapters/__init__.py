"""Edges to hardware: the only importers of `mavsdk` and `serial`; what they hand out are the protocols of `devices`.

Vendor types and vendor errors end here. The binding is `mavsdk` 4 (native, callbacks from its own thread); why its
callbacks are bridged to the event loop here, and not by its `asyncio` wrappers, is said in `adapters.worker_calls` and
`adapters.message_hub`.
"""
