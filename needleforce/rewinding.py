"""An identifier that can undo what it has made of the last samples.

A push on the arm looks like a force at the tip until it is detected: then the
identification goes back to where it was before the push began.
"""

from typing import NamedTuple

from identification import Estimate, Identifier, MixtureConfig, PublishedConfig
from identification import Snapshot as IdentifierSnapshot
from identification.channel import count_depth_from


class Checkpoint(NamedTuple):
    """State of the identification at one instant, to which a session can rewind.

    Attributes:
        time_s: See `SessionEstimate`.
        identifier: State of the identifier at that time.
    """

    time_s: float
    identifier: IdentifierSnapshot


class RewindingIdentifier:
    """An identifier with two checkpoints. Every ``time_s`` is on the session's clock.

    A push on the arm rewinds to the older one. While the two differ, this undoes at
    least a quarter of a second. They are equal, and less may be undone, from an event,
    a rewind or the start of an insertion until the next checkpoint.

    Attributes:
        identifier: Identifies.
        last: Its estimate after the last sample that was used, or what is repeated of
            it.
        contact_m: Depth of the first contact, as known now; None before.
        unused_s: Time of valid samples since the last one that was used.
        is_save_due: Whether a state to rewind to is to be saved. This is put off until
            the sample after the one that made it due, to spread the work.
        older: The checkpoint before ``newer``, or the same one: events are never
            undone.
        newer: State after the sample that made it due, saved when the next one comes.
    """

    def __init__(self, config: MixtureConfig | PublishedConfig) -> None:
        self.identifier = Identifier(config)
        self.begin(0.0)

    def begin(self, time_s: float) -> None:
        """Forget what was identified, and identify anew from now on."""
        self.identifier.reset()
        self._stand_at(self.identifier.snapshot(), time_s, time_s)

    def date(self, time_s: float) -> None:
        """Count unused time from now on, where no sample was used since the begin."""
        self._stand_at(self.newer.identifier, time_s, time_s)

    def go_back(
        self, snapshot: IdentifierSnapshot, begin_s: float, time_s: float
    ) -> None:
        """Undo what was identified since a state: the time since then is a gap.

        Args:
            snapshot: State of the identifier.
            begin_s: Its time.
            time_s: Now.
        """
        self.identifier.restore(snapshot)
        self._stand_at(snapshot, begin_s, time_s)

    def _stand_at(
        self, snapshot: IdentifierSnapshot, begin_s: float, time_s: float
    ) -> None:
        """Take the identifier's state for the only one to rewind to."""
        self.older = self.newer = Checkpoint(begin_s, snapshot)
        self.last = snapshot.last
        self.contact_m = self.identifier.contact_depth_m
        self.unused_s = time_s - begin_s
        self.is_save_due = False

    def restore(
        self,
        snapshot: IdentifierSnapshot,
        checkpoints: tuple[Checkpoint, Checkpoint],
        unused_s: float,
    ) -> None:
        """Continue from a snapshot that this identifier takes."""
        self.go_back(snapshot, 0.0, unused_s)
        self.end_events()
        self.older, self.newer = checkpoints

    def move_zero(self, moved_m: float, time_s: float) -> None:
        """Count depth from another zero; unused time goes on.

        Args:
            moved_m: Depth of a place from the new zero less its depth from the old one.
            time_s: Now.
        """
        unused_s = self.unused_s
        moved = count_depth_from(self.identifier.snapshot(), moved_m)
        self.go_back(moved, time_s, time_s)
        self.unused_s = unused_s

    def use(
        self,
        depth_m: float,
        speed_m_s: float,
        force_N: float,
        elapsed_s: float,
        time_s: float,
        force_std_N: float,
    ) -> Estimate:
        """Return the identifier's estimate after a sample; see `Identifier.update`.

        `accept` keeps it, `skip` may undo it.
        """
        estimate = self.identifier.update(
            depth_m,
            speed_m_s,
            force_N,
            elapsed_s + self.unused_s,
            time_s=time_s,
            force_std_N=force_std_N,
        )
        self.contact_m = self.identifier.contact_depth_m
        self.unused_s = 0.0
        return estimate

    def accept(self, estimate: Estimate, time_s: float) -> None:
        """Keep the estimate of a sample."""
        # Time between states to rewind to: a push on the arm grows for up to this long
        # before it is detected.
        period_s = 0.25
        self.last = estimate
        due_s = self.newer.time_s + period_s
        self.is_save_due = estimate.has_events or time_s >= due_s

    def save(self, time_s: float) -> None:
        """Save a state to rewind to."""
        checkpoint = Checkpoint(time_s, self.identifier.snapshot())
        # An event must not be reported twice: nothing before it is kept.
        self.older = checkpoint if self.last.has_events else self.newer
        self.newer = checkpoint
        self.is_save_due = False

    def skip(self, elapsed_s: float, time_s: float, *, is_spoilt: bool) -> None:
        """Leave out a sample; rewind if those before it are spoilt, too."""
        self.unused_s += elapsed_s
        used_s = time_s - self.unused_s - self.older.time_s
        # Half a time step allows for the rounding of sums of time steps.
        if is_spoilt and used_s > 0.5 * elapsed_s:
            self.go_back(self.older.identifier, self.older.time_s, time_s)

    def end_events(self) -> None:
        """Repeat the last estimate, its events over."""
        self.last = self.last.without_events()
