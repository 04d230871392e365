"""The ground station link over MQTT: payloads, topics, the connection, transactions, and a small ground station."""
