"""The MQTT interface: payloads, topics, broker connection, transactions, and a minimal ground station client."""
