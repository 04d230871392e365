"""Airframe, gimbal and camera as physics, stepped in simulated time."""
