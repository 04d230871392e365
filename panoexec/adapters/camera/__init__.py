"""Cameras: MAVLink, servo and serial shutter; triggers matched with capture messages."""
