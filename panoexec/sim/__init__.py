"""A simulated vehicle that speaks MAVLink 2 on a UDP socket: autopilot, gimbal, camera, faults.

It runs in a process of its own and is the only part of panoexec that imports pymavlink (extra `sim`); nothing else
imports it. `gimbal`, `camera`, `airframe` and `faults` are pure and stepped in simulated time; `payload` and `vehicle`
put them on the wire; `server` ties them to a clock and to sockets.
"""
