"""What all sections of the configuration have in common."""

from __future__ import annotations

from ipaddress import IPv6Address
from typing import Annotated, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

Positive: TypeAlias = Annotated[FiniteFloat, Field(gt=0)]
SkyAt: TypeAlias = Annotated[FiniteFloat, Field(ge=-90, le=90)]
NotNegative: TypeAlias = Annotated[FiniteFloat, Field(ge=0)]
Fraction: TypeAlias = Annotated[FiniteFloat, Field(ge=0, le=1)]
Overlap: TypeAlias = Annotated[FiniteFloat, Field(ge=0, lt=1)]
ToleranceDeg: TypeAlias = Annotated[FiniteFloat, Field(ge=0, le=45)]
Range: TypeAlias = tuple[FiniteFloat, FiniteFloat]
EvidenceName: TypeAlias = Literal[
    "commanded", "acknowledged", "counted", "feedback_pin", "capture_message", "file_seen"
]


class Section(BaseModel):
    """Base of all sections: unknown keys are errors, values are immutable, defaults are validated as well."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)


def ordered_range(value: Range, least: float, most: float) -> Range:
    """The range if it is ascending and within bounds.

    Raises:
        ValueError: it is not; the message says how.
    """
    low, high = value
    if not low < high:
        raise ValueError(f"[{low:g}, {high:g}] is empty or reversed: the first value must be less than the second")
    if low < least or high > most:
        raise ValueError(f"[{low:g}, {high:g}] must lie within [{least:g}, {most:g}]")
    return value


def is_ipv6(text: str) -> bool:
    """Whether a text is an IPv6 address."""
    try:
        IPv6Address(text)
    except ValueError:
        return False
    return True
