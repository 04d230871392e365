"""What `import panoexec` offers to Python programs: plans, and the directories of missions.

Nothing here talks to a vehicle, a camera or a broker: for those there is the MQTT interface (docs/ground-station.md).
"""
