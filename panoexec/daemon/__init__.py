"""The daemon: links to autopilot and broker, missions by request, signs of life for the service manager."""
