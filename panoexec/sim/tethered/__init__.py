"""The simulated camera on a network cable: PTP/IP, as libgphoto2 speaks it."""
