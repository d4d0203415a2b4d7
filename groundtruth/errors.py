"""Errors of the ground truth, and the checks of numbers that raise them.

All have one base; each is also a builtin error, so that both can be caught.
"""

import math
from collections.abc import Callable

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


def _requirement(is_met: Callable[[float], bool], advice: str) -> Callable[..., None]:
    """Return a check of numbers.

    Args:
        is_met: Whether a number passes.
        advice: What to give instead, for the message.
    """

    def require(
        error: type[GroundTruthError],
        owner: object = None,
        names: str = "",
        **values: float,
    ) -> None:
        """Raise ``error`` for the first number that does not pass.

        Args:
            error: Type of the error.
            owner: Object whose fields are checked.
            names: Names of these fields, separated by blanks.
            **values: Further numbers by name.
        """
        for name, value in (
            {n: getattr(owner, n) for n in names.split()} | values
        ).items():
            if not is_met(value):
                raise error(f"{name} is {value!r}; give {advice}")

    return require


require_positive = _requirement(
    lambda x: 0.0 < x < math.inf, "a finite number above zero"
)
require_non_negative = _requirement(
    lambda x: 0.0 <= x < math.inf, "a finite number, zero or above"
)
require_fraction = _requirement(lambda x: 0.0 <= x <= 1.0, "a fraction from 0 to 1")
