"""What tests of several layers share: comparisons of what a mission claims with what the simulator knows."""
