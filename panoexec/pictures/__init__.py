"""Examines photos: readable, exposed, sharp, and tied to their neighbours under the measured attitudes."""
