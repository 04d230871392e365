"""Checks whether missions can be stored; repeated periodically, so that a full disk is reported before the flight."""

from __future__ import annotations

import os

from panoexec.inputs.config import StorageSection


def storage_trouble(section: StorageSection) -> str:
    """The reason why missions cannot be stored, "" if they can. A missing folder is no problem: it will be created."""
    try:
        found = os.statvfs(section.path)
    except FileNotFoundError:
        return ""
    except OSError as error:
        return f"{section.path} cannot be used ({error.strerror})"
    if found.f_flag & os.ST_RDONLY:
        return f"{section.path} is read-only: check the disk, or permit the service to write there"
    free_mb = found.f_bavail * found.f_frsize / 1e6
    if free_mb < section.min_free_mb:
        return f"{section.path} has {free_mb:.0f} MB left: [storage] min_free_mb requires {section.min_free_mb:g}"
    return ""
