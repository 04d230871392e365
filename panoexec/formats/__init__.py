"""Formats of other programs: Hugin projects, XMP, JPEG headers."""
