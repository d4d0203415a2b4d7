"""What numbers do not say, for formats that have room for it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

START_KEY = "start_ns"
"""What files of numbers call `Labels.start_ns`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Labels:
    """Names that go with the columns of a table that is written.

    Bags carry all of them, the other formats `start_ns`, if it is not zero.

    Attributes:
        start_ns: the instant of t_s = 0 on the clock of the source, in ns; a log read from a bag
            has it, and the bag written from it then has the source's stamps, to the nanosecond.
        joint_names: in the order of the columns of `q_rad`, `dq_rad_s` and `tau_Nm`.
        frame: the frame in which forces are given.
        prefix: how the topics of a bag begin that hold estimates.
        events: columns of small whole numbers to what their values 0, 1, 2, ... mean, `{}` for
            the value; the last text holds for all values beyond. A bag gets a diagnostic message
            where the value changes, unless the text is empty.
    """

    start_ns: int = 0
    joint_names: tuple[str, ...] = ()
    frame: str = ""
    prefix: str = "/needleforce"
    events: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


PLAIN = Labels()
"""No names, and a clock that starts at zero."""
