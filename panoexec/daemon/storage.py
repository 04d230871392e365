"""Whether missions can be kept: looked at now and then, so that a crew learns of a full disk before the flight."""

from __future__ import annotations

import os

from panoexec.inputs.config import StorageSection


def storage_trouble(section: StorageSection) -> str:
    """Why no mission could be kept there, "" if one could. A folder that does not exist is made when it is needed."""
    try:
        found = os.statvfs(section.path)
    except FileNotFoundError:
        return ""
    except OSError as error:
        return f"{section.path} cannot be used ({error.strerror})"
    if found.f_flag & os.ST_RDONLY:
        return f"{section.path} is read-only: have the disk looked at, or let the service write there"
    free_mb = found.f_bavail * found.f_frsize / 1e6
    if free_mb < section.min_free_mb:
        return f"{section.path} has {free_mb:.0f} MB left: [storage] min_free_mb asks for {section.min_free_mb:g}"
    return ""
