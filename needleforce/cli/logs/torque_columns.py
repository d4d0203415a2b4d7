"""The option ``--tau`` that corrects the torques of a log, to be copied as it is."""

import re
import shlex
from collections.abc import Sequence
from copy import copy

from foundation.errors import Alternative
from needleforce.cli.logs.log_session import LogSession
from residual import TareError
from residual.bias.torque_texts import CONTAINS_GRAVITY

_NUMBERED = re.compile(r"^(?P<head>.*?)(?P<number>\d+)(?P<tail>\D*)$")
"""A column name with a number, its last."""

OPTION_DIGITS = 6
"""Digits of a factor that is the product of an advice and a mapping."""


def with_torque_option(error: TareError, log: LogSession) -> TareError:
    """Return the error with an advice that names the columns of the log.

    An advice of factors or of an order of the joints becomes the option that does it,
    with the unit and the factors that the columns have already.

    Args:
        error: Of the tare.
        log: The log, of which rows were read.
    """
    named = copy(error)
    named.places = with_option(error.places, log)
    named.alternatives = tuple(
        Alternative(one.code, with_option(one.places, log))
        for one in error.alternatives
    )
    return named


def with_option(places: dict[str, str], log: LogSession) -> dict[str, str]:
    """Return the places of an advice with that of the option, if it has factors."""
    if not places.keys() & {"factors", "order"}:
        return places
    option = torque_option(places, log)
    if CONTAINS_GRAVITY in places:
        option += " without --gravity-compensated"
    return places | {"tau_option": option}


def torque_option(places: dict[str, str], log: LogSession) -> str:
    """Return the value of ``--tau`` for an advice.

    Args:
        places: With ``factors``, one or one for each joint, or with ``order``.
        log: The log, of which rows were read.
    """
    channel = next(one for one in log.units if one.channel == "tau")
    columns = list(channel.columns)
    units = {column.unit for column in channel.units}
    unit = units.pop() if len(units) == 1 else "Nm"
    order = [int(one) - 1 for one in places.get("order", "").split(",") if one]
    if order:
        if len(columns) == 1:
            columns = [f"{columns[0]}[{joint}]" for joint in range(len(order))]
        columns = [columns[joint] for joint in order]
    factors = [float(one) for one in places.get("factors", "1").split(",")]
    known = channel.scale
    scales = list(known) if isinstance(known, tuple) else [known]
    if order and len(scales) > 1:
        scales = [scales[joint] for joint in order]
    size = max(len(factors), len(scales))
    factors = factors * (size // len(factors))
    scales = scales * (size // len(scales))
    products = [a * b for a, b in zip(factors, scales, strict=True)]
    if len(set(products)) == 1:
        products = products[:1]
    text = ",".join(f"{one:.{OPTION_DIGITS}g}" for one in products)
    ending = "" if text == "1" and unit == "Nm" else f":{unit}:{text}"
    return shlex.quote(f"{pattern_of(columns)}{ending}")


def pattern_of(columns: Sequence[str]) -> str:
    """Return names as one pattern where they are numbered in a row, else listed."""
    matches = [match for name in columns if (match := _NUMBERED.match(name))]
    numbers = [int(match["number"]) for match in matches]
    ends = {(match["head"], match["tail"]) for match in matches}
    is_row = len(columns) > 1 and len(matches) == len(columns) and len(ends) == 1
    if is_row and numbers == list(range(numbers[0], numbers[0] + len(numbers))):
        head, tail = ends.pop()
        return f"{head}{{{numbers[0]}..{numbers[-1]}}}{tail}"
    return ",".join(columns)
