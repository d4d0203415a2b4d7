"""The layers that a straight needle crosses."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Layer:
    """A stretch of the path inside one structure; depths along the needle from the entry point."""

    name: str  # of the structure, or `UNLABELLED`
    entry_m: float  # depth at which the needle enters it
    exit_m: float  # depth at which it leaves it: the next layer's entry
    entry_std_m: float  # standard deviation of the former, 0 at the path's first point
    exit_std_m: float  # of the latter, 0 at the path's last point
    is_obstacle: bool  # bone or cartilage


UNLABELLED = "unlabelled"
"""Name of what no structure covers."""
