"""The published figures: which run gives each, and what to compare."""

from pathlib import Path

import msgspec

from benchmarks.judging import expand_groups

FRICTION_FIGURE = "10"
TABLE_ONE = "I"


class PublishedFigure(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True
):
    """One figure of Ferro et al., or their table, as in `published_figures.toml`.

    Attributes:
        number: In the publication.
        title: What it is about.
        scenarios: Runs that give its counterpart.
        shows: What is published.
        see: What to compare in ours; the results stand in the numbers of the run.
        source: Of the force whose friction is compensated online; empty for other
            figures.
        ruptures: What the text says of such a figure, times on the clock of its
            recordings.
        friction: What it says of cumulative friction.
        remaining: What it says of the force that remains behind the last layer.
    """

    number: str
    title: str
    scenarios: tuple[str, ...]
    shows: str
    see: str
    source: str = ""
    ruptures: str = ""
    friction: str = "not stated"
    remaining: str = ""

    @property
    def name(self) -> str:
        """As in the publication."""
        return f"{'Table' if self.number == TABLE_ONE else 'Figure'} {self.number}"

    @property
    def command(self) -> str:
        """Draws all of it."""
        return f"python -m benchmarks run {' '.join(self.scenarios)} --report DIR"


class PublishedFriction(msgspec.Struct, frozen=True):
    """A line of Table I: mean and spread over both speeds [Ns/m]."""

    offline: int
    offline_spread: int
    online: int
    online_spread: int


class _File(msgspec.Struct):
    """What `published_figures.toml` holds."""

    enhanced: str  # to compare in every figure of friction compensated online
    rmse_N: dict[str, float]
    table_one_Ns_per_m: dict[str, PublishedFriction]
    figures: list[PublishedFigure]


_FILE = msgspec.toml.decode(
    Path(__file__).with_suffix(".toml").read_bytes(), type=_File
)
PUBLISHED_FIGURES = tuple(
    msgspec.structs.replace(
        item,
        scenarios=expand_groups(item.scenarios),
        see=f"{item.see} {_FILE.enhanced}" if item.source else item.see,
    )
    for item in _FILE.figures
)
"""In the order of the page."""
PUBLISHED_RMSE_N = _FILE.rmse_N
"""Figure 5: virtual against real F/T sensor on a real LWR 4+, by scenario."""
TABLE_ONE_Ns_per_m = {
    int(percent): line for percent, line in _FILE.table_one_Ns_per_m.items()
}
"""Cumulative friction of single gels, by per cent of isinglass."""
NEEDED = tuple(
    dict.fromkeys(name for item in PUBLISHED_FIGURES for name in item.scenarios)
)
"""Every scenario that some figure needs."""
ENHANCED_FIGURES = {
    (item.scenarios[0], item.source): item for item in PUBLISHED_FIGURES if item.source
}
"""Figure of the friction compensation in a scenario, by the source of its force."""
OFFLINE_PANELS = {
    "gel-70-constant": ("2", "a"),
    "stack-constant": ("2", "b"),
    "gel-70-sinusoidal": ("2", "c"),
    "stack-sinusoidal": ("2", "d"),
    "stack-glove-constant": ("3", ""),
}
"""Figure and panel of the offline fit of a scenario."""
FORCE_PANELS = {"gel-70-constant": ("a", "c"), "stack-glove-constant": ("b", "d")}
"""Panels of Figure 5, over time and over depth."""
