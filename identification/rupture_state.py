"""State machine around a rupture (the authors' framework)."""

from enum import Enum


class RuptureState(Enum):
    """Where the identifier stands with respect to a rupture."""

    NO_RUPTURE = "no rupture"
    EXPECTED = "expected"
    DETECTED = "detected"
    FORCE_DROP_MEASURING = "force drop measuring"
    COMPENSATED = "compensated"


MUTED = frozenset({RuptureState.FORCE_DROP_MEASURING, RuptureState.COMPENSATED})
"""States in which no new rupture is looked for."""


def next_rupture_state(
    state: RuptureState,
    *,
    is_alarm: bool = False,
    is_expected: bool = False,
    is_measured: bool = False,
    is_settled: bool = True,
) -> RuptureState:
    """Advance the machine by one sample.

    Args:
        state: Current state.
        is_alarm: The change detector alarms.
        is_expected: The filtered force derivative is beyond its threshold.
        is_measured: T_drop has passed, the force drop can be computed.
        is_settled: The estimate has been re-initialised after the compensation.
    """
    if state in (RuptureState.NO_RUPTURE, RuptureState.EXPECTED):
        if is_alarm:
            return RuptureState.DETECTED
        return RuptureState.EXPECTED if is_expected else RuptureState.NO_RUPTURE
    if state is RuptureState.DETECTED:
        return RuptureState.FORCE_DROP_MEASURING
    if state is RuptureState.FORCE_DROP_MEASURING:
        return RuptureState.COMPENSATED if is_measured else state
    return RuptureState.NO_RUPTURE if is_settled else state
