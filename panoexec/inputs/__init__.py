"""What a person or a file hands in: configuration, camera profiles, plan files, and the plan specification."""
