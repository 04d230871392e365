"""The one model of a lens: distortion of Brown and Conrady, and what of an image is certainly seen."""
