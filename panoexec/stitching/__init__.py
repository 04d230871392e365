"""From a mission directory to a panorama: Hugin's tools find points and remap, panoexec aligns, blends and judges."""
