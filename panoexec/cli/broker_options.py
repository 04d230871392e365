"""The options of `send` and `watch` that select the broker and the vehicle."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from pydantic import ValidationError

from panoexec.errors import InputFileError, UsageError
from panoexec.inputs.config import load_config
from panoexec.inputs.service_sections import MqttSection
from panoexec.inputs.validation import problem_lines

_OPTIONS = ("host", "port", "prefix", "protocol", "username", "password_file", "ca_file", "cert_file", "key_file")


def add_broker_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options for broker and credentials, which override those of a configuration file."""
    group = parser.add_argument_group("broker (options override --config, which overrides the defaults)")
    group.add_argument("--config", type=Path, metavar="FILE", help="configuration file with [mqtt] and [vehicle]")
    group.add_argument("--vehicle", metavar="ID", help="vehicle id (drone)")
    group.add_argument("--host", help="host name or address of the broker (127.0.0.1)")
    group.add_argument("--port", type=int, metavar="N", help="port of the broker (1883)")
    group.add_argument("--prefix", help="topic prefix (panoexec)")
    group.add_argument("--protocol", choices=("5", "3.1.1"), help="MQTT version (5)")
    group.add_argument("--username", help="user name for the broker")
    group.add_argument("--password-file", type=Path, metavar="FILE", help="file with the password")
    group.add_argument("--ca-file", type=Path, metavar="FILE", help="CA certificate; enables TLS")
    group.add_argument("--cert-file", type=Path, metavar="FILE", help="client certificate")
    group.add_argument("--key-file", type=Path, metavar="FILE", help="private key of the client certificate")


def broker_of(args: argparse.Namespace) -> tuple[MqttSection, str]:
    """The broker settings and the vehicle id.

    Raises:
        UsageError: an option or the configuration is wrong.
    """
    section, vehicle = MqttSection(), "drone"
    if args.config is not None:
        config = load_config(args.config, os.environ)
        section, vehicle = config.mqtt, config.vehicle.id
    given = {name: value for name in _OPTIONS if (value := getattr(args, name)) is not None}
    try:
        section = MqttSection.model_validate(section.model_dump() | given)
    except ValidationError as error:
        raise InputFileError("options", problem_lines(error)) from error
    if section.host is None:
        section = section.model_copy(update={"host": "127.0.0.1"})
    vehicle = args.vehicle or vehicle
    if any(char in vehicle for char in "/+#"):
        raise UsageError(f"--vehicle {vehicle}: an id must not contain / + or #")
    return section, vehicle
