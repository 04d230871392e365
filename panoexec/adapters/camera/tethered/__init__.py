"""Cameras on a cable, or on a network, by libgphoto2 in a process of its own."""
