"""What the simulated camera sees: scenes, rendering, JPEG files."""
