"""The result of a log: as text, as JSON, and as a page."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pandas as pd

from needleforce import plots
from needleforce.cli.terminal import aligned, json_text, table_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NOTE = "Research only: not a medical device."

Draw = Callable[[float], "Figure"]
"""Draws a figure of a width [in]."""


class CaptionedFigure(NamedTuple):
    """A figure of a page.

    Attributes:
        draw: Draws it.
        caption: Stands below it.
    """

    draw: Draw
    caption: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """What was found in a log.

    Attributes:
        log: Name of the log.
        title: What a page of it shows.
        sentences: What was found.
        warnings: What makes it doubtful.
        facts: Text of what was used, done and estimated, by label.
        tables: Cells of text by caption, under the heads of their columns.
        notes: What stands below a table, by its caption.
        units: In which unit each channel was read, and whence that is known.
        figures: Figures of a page by the names of their files, without ending.
        settings: Dataclasses of settings by what they are of.
        files: Further files of a report, by name.
    """

    log: str
    title: str
    sentences: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    figures: Mapping[str, CaptionedFigure] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, bytes] = field(default_factory=dict)

    def joined(self, more: "Result") -> "Result":
        """Return this and what another step found in the same log, in this order."""
        joined: dict[str, Any] = {"log": self.log, "title": self.title}
        for name in ("sentences", "warnings"):
            joined[name] = (*getattr(self, name), *getattr(more, name))
        for name in ("facts", "tables", "notes", "units", "figures", "settings"):
            joined[name] = {**getattr(self, name), **getattr(more, name)}
        return Result(**joined, files={**self.files, **more.files})

    def text(self) -> str:
        """Return it as lines for a terminal."""
        parts = [aligned(self.facts.items())]
        for caption, rows in self.tables.items():
            parts.append(f"{table_text(rows)}{self.notes[caption]}\n")
        parts.append("".join(f"{text}\n" for text in self.sentences))
        parts.append(aligned([("channel", "read as"), *self.units.items()]))
        return "\n".join(filter(None, parts))

    def json(self) -> str:
        """Return it as JSON."""
        content = {
            "log": self.log,
            "sentences": self.sentences,
            "warnings": self.warnings,
            "facts": self.facts,
            "tables": {
                caption: rows.to_dict("records")
                for caption, rows in self.tables.items()
            },
            "channels": self.units,
        }
        return json_text(content)

    def write_page(self, folder: Path) -> None:
        """Write it as a page, with its figures, into a folder."""
        for name, content in self.files.items():
            (folder / name).write_bytes(content)
        facts = _pairs_table("What was used, done and found", self.facts)
        channels = _pairs_table(
            "In which unit each channel was read, and whence that is known", self.units
        )
        page_figures = tuple(
            plots.PageFigure(
                path=save(figure.draw, folder / f"{name}.svg"),
                wide=save(figure.draw, folder / f"{name}-wide.svg", plots.WIDE_IN),
                alt=f"{name.replace('-', ' ')} of {self.log}",
                caption=figure.caption,
            )
            for name, figure in self.figures.items()
        )
        parts: dict[str, dict[str, Any]] = {"Figures": {"figures": page_figures}}
        if self.facts:
            parts["Summary"] = {"tables": (facts,)}
        if self.units:
            parts["Channels"] = {"tables": (channels,)}
        for what, settings in self.settings.items():
            table = plots.settings_table(
                settings, "As in a file for --config, SI units"
            )
            parts[f"Settings of the {what}"] = {"tables": (table,)}
        force = self.facts.get("axial force")
        force_lead = (f"Force along the needle: {force}.",) if force else ()
        page = plots.Page(
            title=f"{self.title} from {self.log}",
            lead=(*self.sentences, *force_lead, NOTE),
            notices=tuple(f"Warning: {text}" for text in self.warnings),
            tables=tuple(
                _page_table(caption, rows, self.notes[caption])
                for caption, rows in self.tables.items()
            ),
            sections=tuple(
                plots.Section(heading=heading, anchor=heading.split()[-1].lower(), **of)
                for heading, of in parts.items()
            ),
        )
        plots.write_page(folder / plots.PAGE, page)


def save(draw: Draw, path: Path, width_in: float = plots.WIDTH_IN) -> Path:
    """Draw a figure and write it whole, as PNG, SVG or PDF by the ending of its name.

    Returns:
        The path.
    """
    from matplotlib import rc_context

    with rc_context(fname=plots.STYLE):
        return plots.save_figure(draw(width_in), path)


def _pairs_table(caption: str, pairs: Mapping[str, str]) -> plots.PageTable:
    """Return labels and their texts as a table of a page."""
    return plots.PageTable(caption=caption, head=("", ""), rows=tuple(pairs.items()))


def _page_table(caption: str, rows: pd.DataFrame, note: str) -> plots.PageTable:
    """Return a table of a page; numbers line up on the right."""
    is_number = [cells.str.match(r"[-+\d]").all() for _, cells in rows.items()]
    return plots.PageTable(
        caption=caption,
        head=tuple(rows.columns),
        rows=tuple(rows.itertuples(index=False, name=None)),
        numeric=frozenset(k for k, yes in enumerate(is_number) if yes),
        note=note,
    )
