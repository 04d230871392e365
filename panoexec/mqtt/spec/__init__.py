"""The AsyncAPI document of the MQTT interface, generated from the models."""
