"""The system manager: what may move when, and why something was stopped or refused.

One table of rules is the whole machine; `transition` applies it and is all that a
replay needs. The manager reads the arm's samples, runs the session and the monitors,
and logs every event, as a JSON line at once and as MCAP afterwards.
"""

import math
import os
from collections.abc import Collection, Iterable
from contextlib import suppress
from enum import StrEnum
from importlib import import_module
from io import BytesIO
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from needleforce.control.errors import SettingError
from needleforce.control.monitors import NOTHING, Beside, Monitors, SafetyLimits
from needleforce.control.ports import ArmSample
from residual.checks.input import as_float
from residual.errors import TareError
from residual.estimate import Status

if TYPE_CHECKING:
    from needleforce.session import InsertionSession, SessionEstimate


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
_PLACED = MOVING - {State.GUIDANCE}  # States whose motions depend on the depth


class Rule(NamedTuple):
    """In which states an event leads to another one, and what must hold for it.

    Attributes:
        target: "same": nothing changes, and that is no refusal.
        guards: Of `REFUSALS`.
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

REFUSALS = {
    "limit": "no force limit is set: give the manager SafetyLimits",
    "heartbeat": "the program in charge shows no sign of life: call heartbeat() in every cycle",
    "tared": "the force sensor is not tared: request a tare in free air",
    "outside": "the needle is in tissue, or nobody knows yet: withdraw it first",
    "device": "no haptic device answers: connect it and read it in every cycle",
    "healthy": "the fault persists: see the last reason",
}
"""The facts that guards look at, and why an event is refused where one does not
hold."""


def transition(state: State, event: str, facts: Collection[str]) -> tuple[State, str]:
    """The state after an event, and why it was refused; empty if it was not.

    Facts are those of `REFUSALS` that held when it came. `SettingError` for an unknown
    event.
    """
    rules = {
        name: rule
        for rule in TABLE
        if rule.event == event
        for name in rule.sources.split()
    }
    if not rules:
        raise SettingError(
            f"unknown event {event!r}, expected one of {', '.join(EVENTS)}"
        )
    if (rule := rules.get(state)) is None:
        return state, f"{event} is not possible in {state}, only in {', '.join(rules)}"
    missing = [REFUSALS[guard] for guard in rule.guards.split() if guard not in facts]
    stays = missing or rule.target == "same"
    return state if stays else State(rule.target), missing[0] if missing else ""


class LoggedEvent(
    msgspec.Struct, frozen=True, rename={"origin": "from", "target": "to"}
):
    """One event, a refused one included.

    Attributes:
        seq: Counts from 0.
        t_s: On the manager's clock.
        origin: State before it; "from" in the file.
        target: State after it; "to" in the file.
        refused: Why it was refused; empty if it was not.
        data: What came with it, and the facts it met.
    """

    seq: int
    t_s: float
    origin: str
    event: str
    target: str
    refused: str
    data: dict[str, Any]


MCAP_TOPIC = "/needleforce/events"
_ENCODER = msgspec.json.Encoder(enc_hook=str)


def write_mcap(events: Iterable[LoggedEvent], path: str | Path) -> None:
    """Write events as JSON messages of an MCAP file, on the manager's clock; it
    replaces another.

    Raises:
        SettingError: The extra ``recordings`` is not installed.
        OSError: The file cannot be written.
    """
    writer = _mcap("writer").Writer(str(path))
    writer.start(library="needleforce")
    schema = msgspec.json.encode(msgspec.json.schema(LoggedEvent))
    schema_id = writer.register_schema("LoggedEvent", "jsonschema", schema)
    channel_id = writer.register_channel(MCAP_TOPIC, "json", schema_id)
    for event in events:
        time_ns = round(1e9 * event.t_s)
        writer.add_message(
            channel_id, time_ns, _ENCODER.encode(event), time_ns, event.seq
        )
    writer.finish()


def _mcap(part: str) -> Any:
    try:
        return import_module(f"mcap.{part}")
    except ImportError:
        raise SettingError("MCAP needs: pip install mcap") from None


def read_events(path: str | Path) -> list[LoggedEvent]:
    """Read a log back, of JSON lines or, where its name ends in ``.mcap``, of MCAP.

    Raises:
        SettingError: A line is no event, or the numbers of the events do not follow
            each other; they start anew where another session was appended. Or the file
            is no MCAP, or damaged.
        OSError: The file cannot be read.
    """
    data = Path(path).read_bytes()
    events = list[LoggedEvent]()
    lines = data.splitlines()
    if Path(path).suffix == ".mcap":
        mcap = _mcap("reader")
        try:  # in the order written: the clock of a session that was appended begins anew
            reader = mcap.make_reader(BytesIO(data), validate_crcs=True)
            messages = reader.iter_messages(topics=[MCAP_TOPIC], log_time_order=False)
            lines = [message.data for _, _, message in messages]
        except Exception as error:  # whatever the library makes of a damaged file
            raise SettingError(
                f"{path} is no MCAP file, or a damaged one: {error!r}"
            ) from error
    for number, line in enumerate(lines, 1):
        try:
            event = msgspec.json.decode(line, type=LoggedEvent)
        except msgspec.DecodeError as error:
            raise SettingError(
                f"{path}, line {number} is no event: {line[:80]!r}"
            ) from error
        if event.seq not in (0, events[-1].seq + 1 if events else 0):
            raise SettingError(
                f"{path}, line {number}: event {event.seq} is out of order"
            )
        events.append(event)
    return events


def replay(events: Iterable[LoggedEvent]) -> list[State]:
    """States after each event, from the events and the facts they met; a session
    begins idle.
    """
    state = State.IDLE
    states = []
    for event in events:
        before = State.IDLE if event.seq == 0 else state
        state, _ = transition(before, event.event, event.data["facts"])
        states.append(state)
    return states


class Situation(NamedTuple):
    """What the manager knows after a sample.

    Attributes:
        state_s: Time in this state.
        reason: Why it was stopped, faulted or refused last; empty if it never was.
    """

    state: State
    state_s: float
    time_s: (
        float  # sum of the time steps, a step over 0.1 s counted as the one before it
    )
    reason: str
    estimate: "SessionEstimate"

    @property
    def is_moving(self) -> bool:
        """Whether the arm may be commanded to move; otherwise command rest."""
        return self.state in MOVING


_ENTRY_MARGIN_M = (
    1e-3  # So far above the place of the first contact the needle counts as outside
)
_LONGEST_STEP_S = (
    0.1  # A longer time step is a clock that was set, not time that passed here
)
_HEARTBEAT_S = 0.1  # Longest time between two heartbeats


class Manager:
    """Schedules the modes of the arm, watches them, and logs why.

    Call `heartbeat` and `update` in every cycle. A motion without a heartbeat for 0.1 s
    is stopped. At the end of the state ``tare``, with the arm at rest, `request` takes
    a few tenths of a second; what an arm that does not wait has sent meanwhile may be
    lost.

    Args:
        session: Force sensor and identification, for the manager alone to update.
        limits: What stops a motion; without them nothing moves.
        log: File to append the events to, one JSON object per line; None: `events`
            keeps them.

    Attributes:
        events: Events so far, refusals included. What could not be written,
            `Situation.reason` says so, is written with the next event.

    Raises:
        SettingError: The session or the limits are none, or the session names a frame
            or an axis.
        OSError: The log cannot be written.
    """

    def __init__(
        self,
        session: "InsertionSession",
        limits: SafetyLimits | None = None,
        *,
        log: str | Path | None = None,
    ) -> None:
        if not (
            hasattr(session, "sensor_config")
            and isinstance(limits, SafetyLimits | None)
        ):
            what = f"{session!r:.80} and {limits!r}"
            raise SettingError(
                f"got {what}, expected an InsertionSession and SafetyLimits or None"
            )
        config = session.sensor_config
        x, y, z = config.insertion_axis
        if config.frame is not None or x != 0.0 or y != 0.0 or z <= 0.0:
            raise SettingError(
                f"the session's needle is {config.insertion_axis} of frame {config.frame}; motions "
                "are along z of the robot's tool frame: load the robot with such a tool frame"
            )
        if log is not None:
            Path(log).open("ab").close()
        self.session = session
        self._limits = limits
        self._log = log
        self._written = 0
        self._monitors = Monitors(session, limits or SafetyLimits(axial_N=1.0))
        self.events: list[LoggedEvent] = []
        self._state = State.IDLE
        self._entered_s = 0.0
        self._reason = ""
        self._time_s = 0.0
        self._step_s = 1e-3
        self._beat_s = -_HEARTBEAT_S
        self._depth_m = self._entry_m = math.inf  # nobody knows where the needle is
        self._zero = self._lost_zero = self._entered_zero = session.zero

    def heartbeat(self) -> None:
        """The program in charge is alive."""
        self._beat_s = self._time_s

    def update(self, sample: ArmSample, beside: Beside = NOTHING) -> Situation:
        """Take one sample of the arm and what came beside it; never raises for a bad
        one.
        """
        names = "q_rad", "dq_rad_s", "tau_Nm", "dt_s"
        signals: list[Any] = [getattr(sample, name, None) for name in names]
        since_s = as_float(signals[-1])
        if 0.0 < since_s <= _LONGEST_STEP_S:
            self._step_s = since_s
        self._time_s += self._step_s
        estimate = self.session.update(*signals)
        self._find_entry(estimate)
        event, reason = self._monitors.update(estimate, sample, beside, self._step_s)
        if (
            not event
            and self.session.zero is not self._entered_zero
            and self._state in _PLACED
        ):
            event = "limit"
            reason = "depth counts from elsewhere: begin_insertion() only at idle"
        if event and self._state is not State.FAULTED:
            self._apply(event, {"reason": reason})
        elif self._state in MOVING and "heartbeat" not in self._facts():
            self._apply("stop", {"reason": f"no heartbeat for {_HEARTBEAT_S:g} s"})
        state_s = self._time_s - self._entered_s
        return Situation(self._state, state_s, self._time_s, self._reason, estimate)

    def _find_entry(self, estimate: "SessionEstimate") -> None:
        """Where tissue begins: infinitely deep before it is met, -inf for who begins
        inside it.
        """
        if estimate.status is Status.REJECTED:
            return  # it repeats the last depth, or none
        is_first = self._depth_m == math.inf
        is_inside = estimate.identification.layer > 0
        is_new = is_first or self.session.zero is not self._zero
        if (
            is_new and not is_first
        ):  # outside the next insertion may be at another place
            moved_m = estimate.depth_m - self._depth_m
            self._entry_m = (
                math.inf if "outside" in self._facts() else self._entry_m + moved_m
            )
        self._zero = self.session.zero
        self._depth_m = estimate.depth_m
        if is_inside and math.isinf(self._entry_m):
            self._lost_zero = self._zero
            if self._entry_m > 0.0:
                self._entry_m = -math.inf if is_new else self._depth_m
        elif (
            not is_inside
            and self._entry_m == -math.inf
            and self._lost_zero is self._zero
        ):
            self._entry_m = self._depth_m

    def request(self, event: str, **data: Any) -> str:
        """Ask for a transition; returns why it is refused, empty if it is not.

        Args:
            event: One of `EVENTS`; `SettingError` for any other.
            data: What the log should hold beside it; a ``reason`` shows in
                `Situation.reason`.
        """
        if event == "arrived" and self._state is State.TARE:
            start_s = monotonic()
            try:
                self.session.tare()
            except TareError as error:
                return self._apply("limit", {"reason": f"the tare is refused: {error}"})
            finally:
                self._monitors.missed_s = monotonic() - start_s
            self._entry_m = math.inf
        refused = self._apply(event, data)
        if event == "tare" and not refused:
            self.session.start_tare_recording()
        return refused

    def _apply(self, event: str, data: dict[str, Any]) -> str:
        facts = self._facts()
        before = self._state
        after, refused = transition(before, event, facts)
        seq = len(self.events)
        data = {**data, "facts": facts}
        row = LoggedEvent(seq, self._time_s, before, event, after, refused, data)
        try:
            _ENCODER.encode(row)
        except (ValueError, RecursionError) as error:
            raise SettingError(
                f"data of {event} cannot be written as JSON: {error}"
            ) from error
        self.events.append(row)
        self._reason = refused or str(data.get("reason", "")) or self._reason
        self._state = after
        if after is not before:
            self._entered_s = self._time_s
            self._entered_zero = (
                self.session.zero if before is State.IDLE else self._entered_zero
            )
            self._monitors.enter(after)
        if self._log is not None:
            self._write(self._log)
        return refused

    def _write(self, log: str | Path) -> None:
        """Write events at once, so that a crash loses none; a full disk stops no
        monitor.
        """
        size = None
        try:
            with Path(log).open("ab") as file:
                size = file.tell()
                file.write(_ENCODER.encode_lines(self.events[self._written :]))
            self._written = len(self.events)
        except OSError as error:
            if size is not None:
                with suppress(OSError):  # half a line would spoil the next one
                    os.truncate(log, size)
            self._reason = f"{self._reason}; the log cannot be written: {error}".lstrip(
                "; "
            )

    def _facts(self) -> list[str]:
        holds = {
            "limit": self._limits is not None,
            "heartbeat": self._time_s - self._beat_s < _HEARTBEAT_S,
            "tared": self.session.tared,
            "outside": self._depth_m < self._entry_m - _ENTRY_MARGIN_M,
            "device": self._monitors.has_device,
            "healthy": self._monitors.is_healthy,
        }
        return [name for name, is_so in holds.items() if is_so]
