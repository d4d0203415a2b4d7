"""Errors of the ground truth, and the checks of numbers that raise them.

All have one base; each is also a builtin error, so that both can be caught.
"""

import math
from collections.abc import Callable

from foundation.errors import CodedError, ErrorCode
from foundation.extras import install_command


class SimulationCode(ErrorCode):
    """Kinds of errors of the simulated ground truth."""

    TISSUE = (
        "NF-SIMULATION-TISSUE",
        "A layer, a membrane or a sample of depth is none that tissue can have.",
        "Give what the message expects, in SI units.",
    )
    MOTION = (
        "NF-SIMULATION-MOTION",
        "The motion cannot be carried out by the needle or the arm.",
        "Change start, travel or speed of the motion.",
    )
    SCENARIO = (
        "NF-SIMULATION-SCENARIO",
        "There is no scenario of that name.",
        "Give one of the names that the message lists; `SCENARIOS` has them all.",
    )
    PLANT_MODEL = (
        "NF-SIMULATION-PLANT-MODEL",
        "There is no plant model of that name, or its numbers cannot be.",
        "Give one of `PLANT_MODELS`, or correct the field that the message names.",
    )
    ARM = (
        "NF-SIMULATION-ARM",
        "The simulated arm cannot run, or has left its commanded motion.",
        "Use softer tissue, a slower motion, or the settings that the message expects.",
    )
    LIBRARY = (
        "NF-SIMULATION-LIBRARY",
        "The simulated arm needs a library that is not installed.",
        f"Install it: {install_command('demo')}.",
    )


class GroundTruthError(CodedError):
    """Base of every error this package raises on purpose."""

    usual_code = SimulationCode.ARM


class TissueError(GroundTruthError, ValueError):
    """A layer, membrane or friction that no tissue can have, or an unusable sample."""

    usual_code = SimulationCode.TISSUE


class MotionError(GroundTruthError, ValueError):
    """A motion that cannot be carried out or sampled.

    It has no travel or no rate, or is out of the arm's reach.
    """

    usual_code = SimulationCode.MOTION


class ScenarioError(GroundTruthError, LookupError):
    """An unknown scenario or tissue law; the message lists the known ones."""

    usual_code = SimulationCode.SCENARIO


class PlantModelError(GroundTruthError, ValueError):
    """An unknown plant model, an impossible noise, or links that cannot be blended."""

    usual_code = SimulationCode.PLANT_MODEL


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
