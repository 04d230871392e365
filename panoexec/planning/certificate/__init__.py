"""Certification of a plan: coverage, overlaps and connectivity under every pointing error (C1 to C4)."""
