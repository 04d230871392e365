"""Options that say where missions are stored."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from panoexec.errors import UsageError
from panoexec.inputs.config import load_config
from panoexec.inputs.service_sections import StorageSection

CONFIG = Path("/etc/panoexec/config.toml")


def add_storage_arguments(parser: argparse.ArgumentParser) -> None:
    """Add `--storage` and `--config`."""
    parser.add_argument("--storage", type=Path, metavar="DIR", help="storage folder, which has the folder missions")
    parser.add_argument("--config", type=Path, metavar="FILE", help=f"configuration that names it ({CONFIG})")


def storage_of(args: argparse.Namespace) -> Path:
    """The storage folder: as given, of the configuration, else the daemon's.

    Raises:
        UsageError: it does not exist, or cannot be entered.
        InputFileError: the configuration is invalid.
    """
    storage: Path
    if args.storage is not None:
        storage = args.storage
    elif args.config is not None or os.access(CONFIG, os.R_OK):
        storage = load_config(args.config or CONFIG, os.environ).storage.path
    else:
        storage = StorageSection().path
    try:
        next(storage.iterdir(), None)
    except PermissionError as error:
        raise UsageError(
            f"{storage}: cannot be entered; members of the group panoexec may read it (adduser USER panoexec)"
        ) from error
    except OSError as error:
        raise UsageError(f"{storage}: {error.strerror}; give the storage folder by --storage DIR") from error
    return storage
