"""The paper's simulation case: its plans and ours, photographed in a scene with its errors, stitched, and judged."""
