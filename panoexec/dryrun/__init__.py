"""Dry-runs, on the embedded simulation, an ArduPilot SITL, or a vehicle that is already running.

ArduPilot is not part of panoexec: the user provides an ArduCopter SITL binary. This package starts it with the few
parameters it needs (`ardupilot-sitl.parm`), attaches the simulated payload of `panoexec.sim`, and stops all processes
at the end of the dry-run, however it ends.
"""
