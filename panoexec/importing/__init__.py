"""The photos of a memory card, paired with the attempts of a mission."""
