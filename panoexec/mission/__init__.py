"""Mission execution: slew, settle, capture, verify, accept or retake.

This package does no I/O: devices, journal, clock and event sink are injected as protocols.
"""
