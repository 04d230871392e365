"""The gimbal by MAVLink gimbal protocol v2: commands, attitude messages and their time stamps."""
