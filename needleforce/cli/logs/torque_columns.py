"""Options that correct the torques of a log, to be copied as they are."""

import re
import shlex
from collections.abc import Sequence

from needleforce.cli.logs.log_session import LogSession
from needleforce.recordings.channel_units import ChannelUnit
from residual.bias.torque_diagnosis import Explanation
from residual.bias.torque_fit import Correction

_NUMBERED = re.compile(r"^(?P<head>.*?)(?P<number>\d+)(?P<tail>\D*)$")
"""A column name with a number, its last."""


def correcting_options(advice: Explanation, log: LogSession) -> str:
    """Return the options that correct a log as an advice says.

    Columns keep the units and the factors that they have already.

    Args:
        advice: The advice.
        log: The log, of which rows were read.
    """
    correction = advice.correction
    options: list[str] = []
    if correction.gravity_m_s2 is not None:
        numbers = " ".join(f"{one:.4g}" for one in correction.gravity_m_s2)
        options.append(f"--gravity {numbers} without --mount")
    if advice.kind == "payload":
        options.append("--payload FILE with these lines")
    if advice.kind in ("unit", "signs", "order"):
        options += _column_options(correction, log)
    # The text speaks of gravity where it is not treated as it was.
    if "torque_is_gravity_compensated=True" in advice.text:
        options.append("--gravity-compensated")
    if "torque_is_gravity_compensated=False" in advice.text:
        options.append("the same options without --gravity-compensated")
    return " and ".join(options)


def _column_options(correction: Correction, log: LogSession) -> list[str]:
    """Return one option that names the columns of every channel that is corrected."""
    ones = [1.0] * len(correction.order)
    factors = {"tau": correction.factors.tolist()}
    if correction.is_order_of_all:
        factors |= {"q": ones, "dq": ones}
    options = [
        f"--{one.channel} "
        + _column_option(one, correction.order, factors[one.channel])
        for one in log.units
        if one.channel in factors
    ]
    return [" ".join(options)]


def _column_option(
    channel: ChannelUnit, order: Sequence[int], factors: list[float]
) -> str:
    """Return columns in another order with their unit and a further factor each."""
    columns = list(channel.columns)
    scales = channel.scale
    known = list(scales) if isinstance(scales, tuple) else [scales] * len(order)
    if list(order) != sorted(order):
        if len(columns) == 1:
            columns = [f"{columns[0]}[{joint}]" for joint in range(len(order))]
        columns = [columns[joint] for joint in order]
    products = [
        factor * known[joint] for factor, joint in zip(factors, order, strict=True)
    ]
    if len(set(products)) == 1:
        products = products[:1]
    text = ",".join(f"{one:.6g}" for one in products)
    units = {column.unit for column in channel.units}
    unit = units.pop() if len(units) == 1 else ""
    is_plain = text == "1" and unit in ("", "Nm", "rad", "rad/s")
    ending = "" if is_plain else f":{unit or 'Nm'}:{text}"
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
