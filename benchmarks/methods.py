"""The two settings of the virtual sensor that are always run side by side."""

from collections.abc import Mapping
from types import MappingProxyType

from benchmarks.row import Method
from residual import DEFAULT, PAPER, SensorConfig

METHODS: Mapping[Method, SensorConfig] = MappingProxyType({"default": DEFAULT, "paper": PAPER})
"""By the name they are reported under."""
