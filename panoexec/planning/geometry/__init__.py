"""Geometry of images on the sphere: footprints, overlap, the band's domain, pointing errors."""
