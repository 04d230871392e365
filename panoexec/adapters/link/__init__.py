"""The MAVLink connection through MAVSDK: session, requests, messages, streams."""
