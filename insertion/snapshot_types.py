"""What snapshots consist of: these types and those that their annotations name."""

from dataclasses import is_dataclass
from enum import Enum

from identification import DefaultConfig, PaperConfig
from identification import Snapshot as IdentifierSnapshot
from identification.default_state import DefaultState
from identification.paper_state import PaperState
from insertion.session_estimate import SessionSnapshot
from residual.sensor_state import SensorState

# The annotations of an identifier's snapshot leave the method open: both are named here.
SNAPSHOT_TYPES = (
    SessionSnapshot,
    SensorState,
    IdentifierSnapshot,
    DefaultState,
    DefaultConfig,
    PaperState,
    PaperConfig,
)
"""Roots; everything else is reached from them."""


def is_state(kind: type) -> bool:
    """Whether a type is one that snapshots may name: an enumeration, or a class of fields."""
    return issubclass(kind, Enum) or is_dataclass(kind) or hasattr(kind, "_fields")
