"""The vehicles that a dry-run is flown on: the embedded simulation, an ArduPilot SITL, or one that runs already.

ArduPilot is no part of panoexec: the user names an ArduCopter SITL binary of their own. This package starts it with the
few parameters it needs (`ardupilot-sitl.parm`), attaches the simulated payload of `panoexec.sim` to it, and makes sure
that nothing outlives the dry-run, however that ends.
"""
