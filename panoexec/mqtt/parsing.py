"""Reading requests from untrusted bytes: one valid request, or an error that says what is wrong."""

from __future__ import annotations

import json
from collections import Counter
from typing import Any, cast

from pydantic import ValidationError

from panoexec.inputs.validation import dotted, problem_lines
from panoexec.mqtt.requests import MAX_PAYLOAD, REQUESTS, RefusedRequestError, Request, Transaction, is_transaction


def parse_request(command: str, payload: bytes, *, retained: bool = False, size: int | None = None) -> Request:
    """Parse a request.

    Args:
        command: the last level of the topic.
        payload: the received payload.
        retained: whether the message was retained; retained commands are rejected.
        size: size of the original payload, if it was discarded because of its size.

    Raises:
        RefusedRequestError: the request is invalid; the transaction is set if it could be parsed.
    """
    length = len(payload) if size is None else size
    if length > MAX_PAYLOAD:
        raise RefusedRequestError("too_large", f"the payload has {length} bytes: at most {MAX_PAYLOAD} are accepted")
    try:
        data = _parse_json(payload)
    except RefusedRequestError:
        _check_topic(command, retained=retained, transaction=None)
        raise
    sent = data.get("transaction")
    transaction = cast("Transaction", sent) if is_transaction(sent) else None
    _check_topic(command, retained=retained, transaction=transaction)
    try:
        return REQUESTS[command].model_validate(data)
    except ValidationError as error:
        location = error.errors(include_url=False, include_input=False)[0]["loc"]
        raise RefusedRequestError(
            "invalid",
            "; ".join(problem_lines(error, REQUESTS[command])[:10]),
            field=dotted(location) or None,
            transaction=transaction,
        ) from error


def _check_topic(command: str, *, retained: bool, transaction: Transaction | None) -> None:
    if command not in REQUESTS:
        raise RefusedRequestError(
            "unknown_command",
            f"unknown command {command[:40]!r}: commands are {', '.join(REQUESTS)}",
            transaction=transaction,
        )
    if retained:
        raise RefusedRequestError(
            "retained",
            "the request was published with the retain flag and would be executed again whenever the vehicle connects: "
            "clear the topic and publish the request without the flag",
            transaction=transaction,
        )


def _parse_json(payload: bytes) -> dict[str, Any]:
    try:
        text = payload.decode("utf-8")
        data = json.loads(text, object_pairs_hook=_unique, parse_constant=_no_constant)
    except UnicodeDecodeError as error:
        raise RefusedRequestError(
            "not_json", f"the payload is not UTF-8: byte {error.start}: {error.reason}"
        ) from error
    except RecursionError as error:
        raise RefusedRequestError("not_json", "the payload is nested too deeply") from error
    except ValueError as error:
        raise RefusedRequestError("not_json", f"the payload is not JSON: {str(error)[:200]}") from error
    if not isinstance(data, dict):
        raise RefusedRequestError("not_json", "the payload is not a JSON object")
    return data


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    data = dict(pairs)
    if len(data) < len(pairs):
        counts = Counter(key for key, _ in pairs)
        twice = next(key for key, count in counts.items() if count > 1)
        raise ValueError(f"key {twice[:40]!r} is duplicated")
    return data


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is not a JSON number")
