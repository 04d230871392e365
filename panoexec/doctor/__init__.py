"""What a mission needs and what is there of it: links, message rates, devices, broker, machine; nothing is changed."""
