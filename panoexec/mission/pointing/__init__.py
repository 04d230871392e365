"""Pointing: measured poses, the gate that judges them against the tolerance, the vehicle's heading."""
