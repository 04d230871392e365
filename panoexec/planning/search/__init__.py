"""The certified planner: rows of images, searched for the fewest that the certificate accepts."""
