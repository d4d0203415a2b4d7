"""What the paper has measured on its own arm."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

PUBLISHED_RMSE_N: Mapping[str, float] = MappingProxyType(
    {"gel-70-constant": 0.2444, "stack-glove-constant": 0.285}
)
"""Figure 5: virtual against real F/T sensor on a real LWR 4+, by scenario [N]."""


class PublishedFriction(NamedTuple):
    """A line of Table I: mean and spread over both speeds [Ns/m]."""

    offline: int
    offline_spread: int
    online: int
    online_spread: int


TABLE_ONE_Ns_per_m: Mapping[int, PublishedFriction] = MappingProxyType(
    {
        25: PublishedFriction(113, 14, 84, 10),
        50: PublishedFriction(283, 21, 232, 16),
        70: PublishedFriction(534, 56, 481, 37),
    }
)
"""Cumulative friction of single gels, by per cent of isinglass."""
