"""Stitching: Hugin's tools find control points and remap; panoexec aligns, blends and measures completeness."""
