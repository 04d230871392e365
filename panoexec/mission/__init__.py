"""Mission execution: slew, settle, capture, verify, accept or retake.

Nothing here does I/O: the devices, the journal, the clock and the sink of events come in as protocols.
"""
