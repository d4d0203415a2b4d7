"""What the page shows: joint positions and the session's estimate, some times a second.

A loop hands over every tick; of those without an event the page needs fifty a second.
"""

from typing import TYPE_CHECKING, NamedTuple

from foundation.arrays import Array
from foundation.errors import NeedleforceError
from needleforce.insertion_events import session_events

if TYPE_CHECKING:
    from needleforce.session import SessionEstimate

KEPT_PERIOD_s = 0.02
"""Time from one moment without an event to the next."""


class SceneError(NeedleforceError):
    """A page or an output that cannot be opened, or what cannot be shown."""

    usual_advice = "Give moments of an insertion, and two points for a plan."


FREE_PORT = "Give a free port of this machine."


class Moment(NamedTuple):
    """A tick of a session.

    Attributes:
        q_rad: Joint positions, shape (n,).
        estimate: What the session made of it.
    """

    q_rad: Array
    estimate: "SessionEstimate"


def is_kept(estimate: "SessionEstimate", latest_s: float) -> bool:
    """Return whether a tick is shown.

    Args:
        estimate: Of the tick.
        latest_s: Time of the latest one that is.
    """
    is_soon = latest_s <= estimate.time_s < latest_s + KEPT_PERIOD_s
    return not is_soon or any(session_events(estimate))
