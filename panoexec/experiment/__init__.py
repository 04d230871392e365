"""The paper's simulation study: its plans and panoexec's, rendered with pointing errors, stitched and evaluated."""
