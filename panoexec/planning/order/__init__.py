"""The order of the shots, the vehicle's headings along it, and its duration."""
