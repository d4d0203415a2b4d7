"""The result of a log: as text, as JSON, and as a page."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pandas as pd

from needleforce import plots
from needleforce.cli.logs import figures
from needleforce.cli.terminal import aligned

NOTE = "Research only: not a medical device."


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table of texts.

    Attributes:
        caption: Stands above it on a page.
        rows: The cells, by the heads of their columns.
        note: Stands below it.
    """

    caption: str
    rows: pd.DataFrame
    note: str = ""

    def text(self) -> str:
        """Return it with aligned columns."""
        lines = [tuple(self.rows.columns), *self.rows.itertuples(index=False)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        cells = [map(str.rjust, line, widths) for line in lines]
        return "".join("  ".join(line) + "\n" for line in cells)

    def for_page(self) -> plots.PageTable:
        """Return it as a page shows it; numbers line up on the right."""
        is_number = [cells.str.match(r"[-+\d]").all() for _, cells in self.rows.items()]
        return plots.PageTable(
            caption=self.caption,
            head=tuple(self.rows.columns),
            rows=tuple(self.rows.itertuples(index=False, name=None)),
            numeric=frozenset(k for k, yes in enumerate(is_number) if yes),
            note=self.note,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A figure of a page.

    Attributes:
        name: Of its file, without ending.
        draw: Draws it.
        caption: Stands below it.
    """

    name: str
    draw: figures.Draw
    caption: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """What was found in a log.

    Attributes:
        log: Name of the log.
        title: What a page of it shows.
        sentences: What was found.
        warnings: What makes it doubtful.
        facts: Label and text of what was used, done and estimated.
        tables: What was found, in numbers.
        units: In which unit each channel was read, and whence that is known.
        figures: Figures of a page.
        settings: Dataclasses of settings by what they are of.
        files: Further files of a report, by name.
    """

    log: str
    title: str
    sentences: tuple[str, ...]
    warnings: tuple[str, ...]
    facts: tuple[tuple[str, str], ...]
    tables: tuple[Table, ...]
    units: tuple[tuple[str, str], ...]
    figures: tuple[Figure, ...]
    settings: Mapping[str, Any]
    files: Mapping[str, bytes]

    def text(self) -> str:
        """Return it as lines for a terminal."""
        parts = [aligned(self.facts)] if self.facts else []
        parts += [f"{table.text()}{table.note}\n" for table in self.tables]
        parts += ["".join(f"{text}\n" for text in self.sentences)]
        parts.append(aligned([("channel", "read as"), *self.units]))
        return "\n".join(filter(None, parts))

    def json(self) -> str:
        """Return it as JSON."""
        content = {
            "log": self.log,
            "sentences": self.sentences,
            "warnings": self.warnings,
            "facts": dict(self.facts),
            "tables": {
                each.caption: each.rows.to_dict("records") for each in self.tables
            },
            "channels": dict(self.units),
        }
        return msgspec.json.format(msgspec.json.encode(content)).decode() + "\n"

    def write_page(self, folder: Path) -> None:
        """Write it as a page, with its figures, into a folder."""
        for name, content in self.files.items():
            (folder / name).write_bytes(content)
        facts = plots.PageTable(
            caption="What was used, done and found", head=("", ""), rows=self.facts
        )
        channels = plots.PageTable(
            caption="In which unit each channel was read, and whence that is known",
            head=("channel", "columns"),
            rows=self.units,
        )
        page_figures = tuple(
            plots.PageFigure(
                path=figures.save(each.draw, folder / f"{each.name}.svg"),
                wide=figures.save(
                    each.draw, folder / f"{each.name}-wide.svg", figures.WIDE_IN
                ),
                alt=f"{each.name.replace('-', ' ')} of {self.log}",
                caption=each.caption,
            )
            for each in self.figures
        )
        sections = [
            plots.Section(heading="Figures", anchor="figures", figures=page_figures),
            *(
                plots.Section(heading="Summary", anchor="summary", tables=(facts,))
                for _ in self.facts[:1]
            ),
            plots.Section(heading="Channels", anchor="channels", tables=(channels,)),
        ]
        for what, settings in self.settings.items():
            table = plots.settings_table(
                settings, "As in a file for --config, SI units"
            )
            sections.append(
                plots.Section(
                    heading=f"Settings of the {what}", anchor=what, tables=(table,)
                )
            )
        forces = dict(self.facts).get("axial force")
        force_lead = (f"Force along the needle: {forces}.",) if forces else ()
        page = plots.Page(
            title=f"{self.title} from {self.log}",
            lead=(*self.sentences, *force_lead, NOTE),
            notices=tuple(f"Warning: {text}" for text in self.warnings),
            tables=tuple(table.for_page() for table in self.tables),
            sections=tuple(sections),
        )
        plots.write_page(folder / plots.PAGE, page)
