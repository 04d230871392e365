"""panoexec: a multirotor takes a complete gigapixel panorama by itself."""

__version__ = "0.1.0"
