"""The result of a log: as text, as JSON, and as a page."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from needleforce import plots
from needleforce.cli.terminal import aligned, json_text, table_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NOTE = "Research only: not a medical device."

Draw = Callable[[float], "Figure"]
"""Draws a figure of a width [in]."""


@dataclass(slots=True, kw_only=True)
class Result:
    """What was found in a log; each step adds what it has found.

    Attributes:
        log: Name of the log.
        title: What a page of it shows.
        sentences: What was found.
        warnings: What makes it doubtful.
        facts: Text of what was used, done and estimated, by label.
        tables: Cells of text by caption, under the heads of their columns.
        units: In which unit each channel was read, and whence that is known.
        figures: Figures of a page by the names of their files, without ending.
        notes: What stands below a table or figure, by its caption or name.
        settings: Dataclasses of settings by what they are of.
        files: Further files of a report, by name.
    """

    log: str
    title: str
    sentences: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    facts: dict[str, str] = field(default_factory=dict)
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    figures: dict[str, Draw] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)

    def text(self) -> str:
        """Return it as lines for a terminal."""
        parts = [aligned(self.facts.items())]
        for caption, rows in self.tables.items():
            parts.append(f"{table_text(rows)}{self.notes[caption]}\n")
        parts.append("".join(f"{text}\n" for text in self.sentences))
        if self.units:
            parts.append(aligned([("channel", "read as"), *self.units.items()]))
        return "\n".join(filter(None, parts))

    def json(self) -> str:
        """Return it as JSON."""
        tables = {name: rows.to_dict("records") for name, rows in self.tables.items()}
        return json_text(
            {
                "log": self.log,
                "sentences": self.sentences,
                "warnings": self.warnings,
                "facts": self.facts,
                "tables": tables,
                "channels": self.units,
            }
        )

    def write_page(self, folder: Path) -> None:
        """Write it as a page, with its figures, into a folder."""
        for name, content in self.files.items():
            (folder / name).write_bytes(content)
        figures = tuple(
            plots.PageFigure(
                path=save(draw, folder / f"{name}.svg"),
                wide=save(draw, folder / f"{name}-wide.svg", plots.WIDE_IN),
                alt=f"{name.replace('-', ' ')} of {self.log}",
                caption=self.notes[name],
            )
            for name, draw in self.figures.items()
        )
        tables = {
            "Summary": _pairs_table("What was used, done and found", self.facts),
            "Channels": _pairs_table(
                "In which unit each channel was read, and whence that is known",
                self.units,
            ),
        }
        tables |= {
            f"Settings of the {what}": plots.settings_table(
                settings, "As in a file for --config, SI units"
            )
            for what, settings in self.settings.items()
        }
        sections = [plots.Section(heading="Figures", anchor="figures", figures=figures)]
        sections += [
            plots.Section(
                heading=heading, anchor=heading.split()[-1].lower(), tables=(table,)
            )
            for heading, table in tables.items()
            if table.rows
        ]
        lead = [*self.sentences, NOTE]
        if "axial force" in self.facts:
            lead.insert(-1, f"Force along the needle: {self.facts['axial force']}.")
        page = plots.Page(
            title=f"{self.title} from {self.log}",
            lead=tuple(lead),
            notices=tuple(f"Warning: {text}" for text in self.warnings),
            tables=tuple(
                _page_table(caption, rows, self.notes[caption])
                for caption, rows in self.tables.items()
            ),
            sections=tuple(sections),
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
