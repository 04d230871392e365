"""Published and brute-force methods that the planner is compared with."""
