"""The order of shooting, how the vehicle yaws in it, and how long it takes."""
