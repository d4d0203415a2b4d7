"""Errors of the ground truth, and the checks of numbers that raise them.

All have one base; each is also a builtin error, so that both can be caught.
"""

import math

from foundation.errors import NeedleforceError


class GroundTruthError(NeedleforceError):
    """Base of every error this package raises on purpose."""

    usual_advice = (
        "Use softer tissue, a slower motion, or the settings that the message expects."
    )


class TissueError(GroundTruthError, ValueError):
    """A layer, membrane or friction that no tissue can have, or an unusable sample."""


class MotionError(GroundTruthError, ValueError):
    """A motion that cannot be carried out or sampled.

    It has no travel or no rate, or is out of the arm's reach.
    """

    usual_advice = "Change start, travel or speed of the motion."


class ScenarioError(GroundTruthError, LookupError):
    """An unknown scenario or tissue law; the message lists the known ones."""

    usual_advice = (
        "Give one of the names that the message lists; `SCENARIOS` has them all."
    )


class PlantModelError(GroundTruthError, ValueError):
    """An unknown plant model, an impossible noise, or links that cannot be blended."""

    usual_advice = (
        "Give one of `PLANT_MODELS`, or correct the field that the message names."
    )


class PlantError(GroundTruthError, RuntimeError):
    """The simulated arm cannot run, or has left its commanded motion."""


def require_positive(
    error: type[GroundTruthError],
    owner: object = None,
    names: str = "",
    **values: float,
) -> None:
    """Raise an error for the first number that is not finite and above zero.

    Args:
        error: Type of the error.
        owner: Object whose fields are checked.
        names: Names of these fields, separated by blanks.
        **values: Further numbers by name.
    """
    for name, value in (
        {name: getattr(owner, name) for name in names.split()} | values
    ).items():
        if not 0.0 < value < math.inf:
            raise error(f"{name} is {value!r}; give a finite number above zero")
