"""The system manager: what may move when, and why something was stopped or refused.

It reads the arm's samples, runs the session and the monitors, applies the rules of
`state_machine`, and logs every event.
"""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from needleforce.control.errors import SettingError
from needleforce.control.monitors import NOTHING, Beside, Monitors, SafetyLimits
from needleforce.control.ports import ArmSample
from needleforce.control.state_machine import MOVING, State, transition
from needleforce.tare_run import TareRun
from residual.checks.input import as_float
from residual.estimate import Status

if TYPE_CHECKING:
    from needleforce.session import InsertionSession, SessionEstimate

MAX_HEARTBEAT_GAP_s = 0.1
"""Longest time between two heartbeats; a program that hangs is noticed as soon."""

_WITH_DEPTH = MOVING - {State.GUIDANCE}
"""States whose motions depend on the depth."""


class LoggedEvent(
    msgspec.Struct, frozen=True, rename={"origin": "from", "target": "to"}
):
    """One event, a refused one included.

    Attributes:
        seq: Counts from 0.
        t_s: On the manager's clock.
        origin: State before it; "from" in the file.
        event: Its name, one of `EVENTS`.
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


class Situation(NamedTuple):
    """What the manager knows after a sample.

    Attributes:
        state: What the arm is doing.
        state_s: Time in this state.
        time_s: Sum of the time steps; a step over 0.1 s counts as the one before it.
        reason: Why it was stopped, faulted or refused last; empty if it never was.
        estimate: Of the session.
    """

    state: State
    state_s: float
    time_s: float
    reason: str
    estimate: "SessionEstimate"

    @property
    def is_moving(self) -> bool:
        """Whether the arm may be commanded to move; otherwise command rest."""
        return self.state in MOVING


class _TissueEntry:
    """Keeps track of the depth at which tissue begins, across new zeros of depth.

    The entry is infinitely deep before it is met. It is at minus infinity for a needle
    that was inside when it was first seen, until it has come out.

    Args:
        zero: Where depth counts from; another object is another zero.
    """

    def __init__(self, zero: object) -> None:
        self._depth_m = math.inf  # nobody knows where the needle is
        self._entry_m = math.inf
        self._zero = zero
        self._zero_inside = zero  # at which the needle was last found inside

    @property
    def is_outside(self) -> bool:
        """Whether the needle is known to be outside tissue, by a millimetre."""
        return self._depth_m < self._entry_m - 1e-3

    def forget(self) -> None:
        """Forget the entry: the needle is in free air."""
        self._entry_m = math.inf

    def update(self, estimate: "SessionEstimate", zero: object) -> None:
        """Follow the needle into tissue and out of it."""
        if estimate.status is Status.REJECTED:
            return  # it repeats the last depth, or none
        is_new_zero = self._depth_m == math.inf
        if zero is not self._zero and not is_new_zero:
            is_new_zero = True
            moved_m = estimate.depth_m - self._depth_m
            # From outside, it may be another place.
            self._entry_m = math.inf if self.is_outside else self._entry_m + moved_m
        self._zero = zero
        self._depth_m = estimate.depth_m
        is_inside = estimate.identification.layer > 0
        if is_inside and math.isinf(self._entry_m):
            self._zero_inside = zero
            if self._entry_m > 0.0:
                self._entry_m = -math.inf if is_new_zero else self._depth_m
        elif not is_inside and self._entry_m == -math.inf and self._zero_inside is zero:
            self._entry_m = self._depth_m


class Manager:
    """Schedules the modes of the arm, watches them, and logs why.

    Call `heartbeat` and `update` in every cycle. A motion without a heartbeat for 0.1 s
    is stopped. Requested at the end of the state ``tare``, with the arm at rest,
    ``arrived`` starts the tare, which is fitted beside the updates that follow; the
    state ends with it, after about a second.

    Args:
        session: Force sensor and identification, for the manager alone to update.
        limits: What stops a motion; without them nothing moves.
        log: File to append the events to, one JSON object per line; None: `events`
            keeps them.

    Attributes:
        session: The same.
        events: Events so far, refusals included. If one cannot be written to the file,
            `Situation.reason` says so and the file ends: a full disk stops no monitor.

    Raises:
        SettingError: The session's needle is not the z axis of its tool frame.
        OSError: The log cannot be written.
    """

    def __init__(
        self,
        session: "InsertionSession",
        limits: SafetyLimits | None = None,
        *,
        log: str | Path | None = None,
    ) -> None:
        config = session.sensor_config
        x, y, z = config.insertion_axis
        if config.frame is not None or x != 0.0 or y != 0.0 or z <= 0.0:
            raise SettingError(
                f"the session's needle is {config.insertion_axis} of frame "
                f"{config.frame}; motions are along z of the robot's tool frame",
                "Load the robot with a `tool_frame` whose z axis is the needle.",
            )
        if log is not None:
            Path(log).open("ab").close()
        self.session = session
        self.events = list[LoggedEvent]()
        self._limits = limits
        self._log = log
        self._monitors = Monitors(session, limits or SafetyLimits(axial_N=1.0))
        self._entry = _TissueEntry(session.zero)
        self._state = State.IDLE
        self._reason = ""
        self._time_s = 0.0
        self._step_s = 1e-3  # until a sample has one
        self._heartbeat_s = -MAX_HEARTBEAT_GAP_s
        self._state_start_s = 0.0
        self._tare = TareRun()
        self._arrival: dict[str, Any] = {}  # data of the request that began it
        self._state_zero = session.zero  # of depth, at which the motion began

    def heartbeat(self) -> None:
        """Note that the program in charge is alive."""
        self._heartbeat_s = self._time_s

    def update(self, sample: ArmSample, beside: Beside = NOTHING) -> Situation:
        """Take in one sample of the arm and what came beside it.

        It never raises for a bad sample.
        """
        names = ("q_rad", "dq_rad_s", "tau_Nm", "dt_s")
        signals: list[Any] = [getattr(sample, name, None) for name in names]
        dt_s = as_float(signals[-1])
        if 0.0 < dt_s <= 0.1:  # a longer one is a clock that was set
            self._step_s = dt_s
        self._time_s += self._step_s
        estimate = self.session.update(*signals)
        self._entry.update(estimate, self.session.zero)
        has_ended = self._tare.after(self.session, estimate)
        if has_ended and self._state is State.TARE and not self._check_tare():
            self._entry.forget()
            self._apply("arrived", self._arrival)
        event, reason = self._monitors.update(estimate, sample, beside, self._step_s)
        is_zero_moved = self.session.zero is not self._state_zero
        if not event and is_zero_moved and self._state in _WITH_DEPTH:
            event = "limit"
            reason = (
                "depth counts from elsewhere: the needle turned in free air, or "
                "begin_insertion() was called; do either at idle or under guidance"
            )
        if event and self._state is not State.FAULTED:
            self._apply(event, {"reason": reason})
        elif self._state in MOVING and not self._has_heartbeat:
            self._apply("stop", {"reason": f"no heartbeat for {MAX_HEARTBEAT_GAP_s} s"})
        return Situation(
            state=self._state,
            state_s=self._time_s - self._state_start_s,
            time_s=self._time_s,
            reason=self._reason,
            estimate=estimate,
        )

    def request(self, event: str, **data: Any) -> str:
        """Ask for a transition; return why it is refused, empty if it is not.

        Args:
            event: One of `EVENTS`.
            data: What the log should hold beside it; a ``reason`` shows in
                `Situation.reason`.

        Raises:
            SettingError: The event is unknown, or the data cannot be written as JSON.
        """
        if event == "arrived" and self._state is State.TARE:
            if self._tare.is_running:
                return ""
            self._tare.start(self.session)
            self._arrival = data
            # The tare itself has moved the zero of depth, no one else.
            self._state_zero = self.session.zero
            return self._check_tare()
        refused = self._apply(event, data)
        if event == "tare" and not refused:
            self.session.start_tare_recording()
            self._tare = TareRun()  # what an earlier one was fitted to is gone
        return refused

    def _check_tare(self) -> str:
        """Stop if the tare is refused; return why."""
        if self._tare.refusal is None:
            return ""
        reason = f"the tare is refused: {self._tare.refusal}"
        return self._apply("limit", {"reason": reason}) or reason

    def _apply(self, event: str, data: dict[str, Any]) -> str:
        """Apply the rules to an event and log it; return why it is refused."""
        facts = self._find_facts()
        origin = self._state
        target, refused = transition(origin, event, facts)
        logged = LoggedEvent(
            seq=len(self.events),
            t_s=self._time_s,
            origin=origin,
            event=event,
            target=target,
            refused=refused,
            data={**data, "facts": facts},
        )
        try:
            line = msgspec.json.encode(logged, enc_hook=str)
        except (ValueError, RecursionError) as error:
            raise SettingError(
                f"data of {event} cannot be written as JSON: {error}"
            ) from error
        self.events.append(logged)
        self._reason = refused or str(data.get("reason", "")) or self._reason
        try:
            if self._log is not None:
                with Path(self._log).open("ab") as file:
                    file.write(line + b"\n")
        except OSError as error:
            self._reason += f"; the log cannot be written and ends here: {error}"
            self._log = None  # a line cut short must stay the last
        if target is not origin:
            if origin is State.IDLE:
                self._state_zero = self.session.zero
            self._state = target
            self._state_start_s = self._time_s
            self._monitors.enter(target)
        return refused

    @property
    def _has_heartbeat(self) -> bool:
        return self._time_s - self._heartbeat_s < MAX_HEARTBEAT_GAP_s

    def _find_facts(self) -> list[str]:
        """Return the names of the facts that hold, see `REFUSALS`."""
        facts = {
            "limit": self._limits is not None,
            "heartbeat": self._has_heartbeat,
            "tared": self.session.tared,
            "outside": self._entry.is_outside,
            "device": self._monitors.has_device,
            "healthy": self._monitors.is_healthy,
        }
        return [name for name, holds in facts.items() if holds]
