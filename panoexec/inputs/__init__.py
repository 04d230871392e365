"""User input: configuration, camera profiles, plan files, and the plan specification."""
