"""The options by which `send` and `watch` say which broker and which vehicle are meant."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from pydantic import ValidationError

from panoexec.errors import InputFileError, UsageError
from panoexec.inputs.config import MqttSection, load_config
from panoexec.inputs.validation import problem_lines

_OPTIONS = ("host", "port", "prefix", "protocol", "username", "password_file", "ca_file", "cert_file", "key_file")


def add_broker_arguments(parser: argparse.ArgumentParser) -> None:
    """Broker and credentials: from a configuration, from options, or the one with the other."""
    group = parser.add_argument_group("broker (what is not given comes from --config, then from the defaults)")
    group.add_argument("--config", type=Path, metavar="FILE", help="a configuration with [mqtt] and [vehicle]")
    group.add_argument("--vehicle", metavar="ID", help="which vehicle (drone)")
    group.add_argument("--host", help="the broker (127.0.0.1)")
    group.add_argument("--port", type=int, metavar="N", help="its port (1883)")
    group.add_argument("--prefix", help="first part of the topics (panoexec)")
    group.add_argument("--protocol", choices=("5", "3.1.1"), help="MQTT version (5)")
    group.add_argument("--username")
    group.add_argument("--password-file", type=Path, metavar="FILE")
    group.add_argument("--ca-file", type=Path, metavar="FILE", help="TLS")
    group.add_argument("--cert-file", type=Path, metavar="FILE")
    group.add_argument("--key-file", type=Path, metavar="FILE")


def broker_of(args: argparse.Namespace) -> tuple[MqttSection, str]:
    """The broker and the vehicle's id.

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
        raise UsageError(f"--vehicle {vehicle}: an id has no / + or # in it")
    return section, vehicle
