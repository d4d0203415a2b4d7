"""What the paper has measured on its own arm."""

from collections.abc import Mapping
from types import MappingProxyType

PUBLISHED_RMSE_N: Mapping[str, float] = MappingProxyType(
    {"gel-70-constant": 0.2444, "stack-glove-constant": 0.285}
)
"""Figure 5: virtual against real F/T sensor on a real LWR 4+, by scenario [N]."""
