"""The certified planner: a search for the rows with the fewest images that the certificate accepts."""
