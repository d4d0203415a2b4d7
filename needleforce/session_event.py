"""An event of an insertion: what a session, its plan and its devices report."""

from typing import NamedTuple


class SessionEvent(NamedTuple):
    """An event of an insertion.

    Attributes:
        kind: ``rupture``, ``rupture_retracted``, ``layer``, ``hard_contact``,
            ``past_target`` or ``too_near``.
        text: One sentence for people.
        values: What is known of it, by name with unit.
    """

    kind: str
    text: str
    values: dict[str, float]
