"""Settings of a camera that must not change within a panorama: by libgphoto2's widgets, or by MAVLink."""
