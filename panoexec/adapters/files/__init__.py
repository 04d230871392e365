"""The files of cameras, brought to this computer: by HTTP, by MAVLink FTP."""
