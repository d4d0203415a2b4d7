"""What an exported page shows beside its film, picture by picture."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.scene.scan_slices import SlicePictures

MIN_FILM_S = 0.05
"""A film lasts at least so long."""


class FilmFrame(NamedTuple):
    """A picture of the film, and what the page says of it.

    Attributes:
        film_s: From the start of the film.
        time_s: Of the session.
        depth_mm: Of the tip, as shown.
        headline: Time, depth and tip force.
        lines: State in words.
        banner: What is shown large, such as that the needle is off the plan.
        card: The clinician's view, as HTML.
        slices: Number of the pictures of the CT; -1 without a CT.
    """

    film_s: float
    time_s: float
    depth_mm: float
    headline: str
    lines: tuple[str, ...]
    banner: str
    card: str
    slices: int


class FilmRupture(NamedTuple):
    """A rupture in the list of a page.

    Attributes:
        time_s: When it was detected.
        until_s: When the alarm was retracted; infinite for one that stands.
        text: Its depth and what it was.
    """

    time_s: float
    until_s: float
    text: str


class Film(NamedTuple):
    """An insertion, picture by picture.

    Attributes:
        frames: Its pictures in the order of time.
        ruptures: What was detected.
        slices: Pictures of the CT, each with those of its planes; none without a CT.
    """

    frames: Sequence[FilmFrame]
    ruptures: Sequence[FilmRupture]
    slices: Sequence[SlicePictures]


def film_times_s(times_s: Array, events_s: Iterable[float], count: int) -> Array:
    """Return when the pictures of a film are taken, shape (n,) [s].

    Args:
        times_s: Of the rows, shape (m,).
        events_s: Of ruptures, each of which gets a picture of its own.
        count: Pictures beside those of ruptures.
    """
    start_s = float(times_s[0])
    end_s = max(float(times_s[-1]), start_s + MIN_FILM_S)
    regular_s = np.linspace(start_s, end_s, max(count, 2))
    shown_s = np.unique(np.concatenate([regular_s, np.array([*events_s])]))
    # Pictures closer in time are one.
    is_apart = np.diff(shown_s, prepend=-np.inf) >= 1e-3
    return shown_s[is_apart]
