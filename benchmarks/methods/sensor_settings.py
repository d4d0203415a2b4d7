"""The two settings of the virtual sensor that are always run side by side."""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from benchmarks.row import Method
from residual import DEFAULT, PAPER, SensorConfig
from urdf import LWR_GEAR_RATIO

METHODS: Mapping[Method, SensorConfig] = MappingProxyType({"default": DEFAULT, "paper": PAPER})
"""By the name they are reported under."""


def on_lwr(config: SensorConfig) -> SensorConfig:
    """A setting with what a user knows of the simulated arm, as of the real one.

    Its torque command is held over each tick, and its gears are in the data sheet.
    """
    prior = replace(config.prior, gear_ratio=LWR_GEAR_RATIO)
    return replace(config, alignment="hold", prior=prior)
