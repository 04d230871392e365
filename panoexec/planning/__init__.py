"""The overlap planner: pure geometry in numpy, no input or output."""
