"""The states of the arm, and one table of rules that is the whole machine."""

from collections.abc import Collection
from enum import StrEnum
from typing import NamedTuple

from needleforce.control.errors import SettingError


class State(StrEnum):
    """What the arm is doing."""

    IDLE = "idle"
    GUIDANCE = "guidance"
    TELEOP = "teleop"
    APPROACH = "approach"
    TARE = "tare"
    INSERTION = "insertion"
    DWELL = "dwell"
    WITHDRAW = "withdraw"
    STOPPED = "stopped"
    FAULTED = "faulted"


MOVING = frozenset(State) - {State.IDLE, State.STOPPED, State.FAULTED}
"""States in which the arm may be commanded to move; in the others it is commanded to
rest."""


class Rule(NamedTuple):
    """In which states an event leads to another one, and what must hold for it.

    Attributes:
        event: The event.
        sources: The states in which it is possible, separated by spaces.
        target: The state after it; "same": nothing changes, and that is no refusal.
        guards: The facts that must hold, of `REFUSALS`, separated by spaces.
    """

    event: str
    sources: str
    target: str
    guards: str = ""


TABLE = (
    # requests of a person or a program
    Rule("guide", "idle", "guidance", "limit heartbeat tared outside"),
    Rule("teleoperate", "idle dwell", "teleop", "limit heartbeat tared device"),
    Rule("approach", "idle", "approach", "limit heartbeat outside"),
    Rule("tare", "idle", "tare", "limit heartbeat outside"),
    Rule("insert", "idle teleop dwell", "insertion", "limit heartbeat tared"),
    Rule(
        "withdraw",
        "idle teleop insertion dwell stopped",
        "withdraw",
        "limit heartbeat tared",
    ),
    Rule("release", "guidance teleop approach tare dwell stopped", "idle"),
    Rule(
        "stop", "idle guidance teleop approach tare insertion dwell withdraw", "stopped"
    ),
    Rule("stop", "stopped faulted", "same"),
    Rule("reset", "faulted", "idle", "healthy"),
    # what a motion comes to
    Rule("arrived", "approach tare withdraw", "idle"),
    Rule("arrived", "insertion", "dwell"),
    Rule("arrived", "dwell", "withdraw", "limit heartbeat tared"),
    Rule("rupture", "insertion", "dwell"),
    # what monitors find
    Rule("limit", "guidance teleop approach tare insertion dwell withdraw", "stopped"),
    Rule("limit", "idle stopped faulted", "same"),
    Rule(
        "fault",
        "idle guidance teleop approach tare insertion dwell withdraw stopped",
        "faulted",
    ),
    Rule("fault", "faulted", "same"),
)
"""Every transition; any other pair of state and event is refused."""

EVENTS = tuple(dict.fromkeys(rule.event for rule in TABLE))
"""The events of the table, each once."""

REFUSALS = {
    "limit": "no force limit is set: give the manager SafetyLimits",
    "heartbeat": "the program in charge shows no sign of life: "
    "call heartbeat() in every cycle",
    "tared": "the force sensor is not tared: request a tare in free air",
    "outside": "the needle is in tissue, or nobody knows yet: withdraw it first",
    "device": "no haptic device answers: connect it and read it in every cycle",
    "healthy": "the fault persists: see the last reason",
}
"""The facts that guards look at, and why an event is refused where one does not
hold."""


def transition(state: State, event: str, facts: Collection[str]) -> tuple[State, str]:
    """Return the state after an event, and why it was refused; empty if it was not.

    Args:
        state: The state before it.
        event: One of `EVENTS`.
        facts: Those of `REFUSALS` that held when it came.

    Raises:
        SettingError: The event is unknown.
    """
    rules = {
        source: rule
        for rule in TABLE
        if rule.event == event
        for source in rule.sources.split()
    }
    if not rules:
        raise SettingError(
            f"unknown event {event!r}, expected one of {', '.join(EVENTS)}"
        )
    if (rule := rules.get(state)) is None:
        return state, f"{event} is not possible in {state}, only in {', '.join(rules)}"
    missing = [guard for guard in rule.guards.split() if guard not in facts]
    if missing:
        return state, REFUSALS[missing[0]]
    return state if rule.target == "same" else State(rule.target), ""
