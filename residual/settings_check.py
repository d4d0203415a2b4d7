"""What the stateful estimators may be set to: the one place where settings are refused."""

import math
import numbers

from residual.errors import ConfigurationError


def check_positive(name: str, value: object) -> None:
    """Refuse a setting that is not a finite positive number.

    Raises:
        ConfigurationError: With the name and what came.
    """
    if not (isinstance(value, numbers.Real) and 0.0 < float(value) < math.inf):
        raise ConfigurationError(f"{name} is {value!r}, expected a finite number > 0")


def check_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    """Refuse a setting that is none of the choices.

    Raises:
        ConfigurationError: With the name, what came and the choices.
    """
    if not (isinstance(value, str) and value in choices):
        raise ConfigurationError(f"{name} is {value!r}, expected one of {list(choices)}")


def check_alignment(alignment: object) -> None:
    """Refuse a torque alignment that does not exist.

    Raises:
        ConfigurationError: With the choices.
    """
    check_choice("alignment", alignment, ("hold", "trapezoid"))


def check_gap(max_gap_s: object) -> None:
    """Refuse a longest time step that is not a finite positive number.

    Raises:
        ConfigurationError: With what came.
    """
    check_positive("max_gap_s", max_gap_s)
