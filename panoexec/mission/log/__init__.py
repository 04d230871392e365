"""The record of a mission: its events, states, and what follows from them."""
