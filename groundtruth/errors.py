"""Errors of the ground truth: one base, each leaf also a builtin, so that both can be caught.

And the checks of numbers that raise them.
"""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class GroundTruthError(Exception):
    """Base of every error this package raises on purpose."""


class TissueError(GroundTruthError, ValueError):
    """A layer, membrane or friction that no tissue can have, or an unusable sample for a law."""


class MotionError(GroundTruthError, ValueError):
    """A motion that cannot be carried out or sampled: no travel, out of reach, no rate."""


class ScenarioError(GroundTruthError, LookupError):
    """An unknown scenario or tissue law; the message lists the known ones."""


class PlantModelError(GroundTruthError, ValueError):
    """An unknown plant model, a noise that cannot be, or link tables that cannot be blended."""


class PlantError(GroundTruthError, RuntimeError):
    """The simulated arm cannot run, or has left its commanded motion."""


def fields_of(owner: object, names: str) -> dict[str, float]:
    """Numbers of an object by name, as the checks below take them."""
    return {name: getattr(owner, name) for name in names.split()}


def require_positive(error: type[GroundTruthError], **values: float) -> None:
    """Raise `error`, naming the field, unless every value is finite and above zero."""
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0.0):
            raise error(f"{name} is {value!r}; give a finite number above zero")


def require_non_negative(error: type[GroundTruthError], **values: float) -> None:
    """Raise `error`, naming the field, unless every value is finite and not negative."""
    for name, value in values.items():
        if not (math.isfinite(value) and value >= 0.0):
            raise error(f"{name} is {value!r}; give a finite number, zero or above")


def require_fraction(error: type[GroundTruthError], **values: float) -> None:
    """Raise `error`, naming the field, unless every value is a fraction from 0 to 1."""
    for name, value in values.items():
        if not 0.0 <= value <= 1.0:
            raise error(f"{name} is {value!r}; give a fraction from 0 to 1")
