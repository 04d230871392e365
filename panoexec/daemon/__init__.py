"""The daemon: links to autopilot and broker, missions on request, watchdog notifications to systemd."""
