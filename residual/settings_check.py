"""What the stateful estimators may be set to: the one place where settings are refused."""

import math
import numbers

import numpy as np

from residual.errors import ConfigurationError


def check_positive(name: str, value: object) -> None:
    """Refuse a setting that is not a finite positive number.

    Raises:
        ConfigurationError: With the name and what came.
    """
    is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
    try:
        is_sound = is_number and 0.0 < float(value) < math.inf  # type: ignore[arg-type]
    except OverflowError:
        is_sound = False
    if not is_sound:
        raise ConfigurationError(f"{name} is {value!r}, expected a finite number > 0")


def check_switch(name: str, value: object) -> None:
    """Refuse a setting that is neither true nor false.

    Raises:
        ConfigurationError: With the name and what came.
    """
    if not isinstance(value, bool | np.bool_):
        raise ConfigurationError(f"{name} is {value!r}, expected True or False")


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
