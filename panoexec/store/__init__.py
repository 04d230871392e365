"""Missions on disk: directory, journal, manifest, and the session that writes them."""
