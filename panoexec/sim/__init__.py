"""A simulated vehicle that speaks MAVLink 2 on a UDP socket: autopilot, gimbal, camera, faults.

It runs in its own process and is the only part of panoexec that imports pymavlink (extra `sim`); no other package
imports it. `physics` and `faults` are pure and stepped in simulated time; `mavlink` implements the components on the
wire, `photos` renders the images; `server` connects them to a clock and to sockets.
"""
