"""The record of a mission: events, states and the values derived from them."""
