"""The simulated vehicle's MAVLink components."""
