"""Images of the simulated camera: scenes, rendering, JPEG files."""
