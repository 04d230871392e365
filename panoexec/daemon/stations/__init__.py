"""Panoramas at waypoints of the autopilot's own mission (docs/stations.md)."""
