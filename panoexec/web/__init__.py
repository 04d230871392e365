"""The server of the operator's page: a client of the MQTT interface that browsers reach by HTTP and one WebSocket."""
