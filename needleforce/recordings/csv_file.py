"""CSV and its kin, plain or compressed with gzip: read whole or as it comes."""

import re
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product
from math import nan

import numpy as np

from needleforce.recordings.channels import KNOWLEDGE, JointRules, Knowledge
from needleforce.recordings.errors import (
    MAX_BYTES,
    FaultCounts,
    FormatError,
    require_size,
)
from needleforce.recordings.follow import FollowOptions
from needleforce.recordings.table import (
    HEAD_ROWS,
    MAX_LIST_NUMBERS,
    START_KEY,
    Table,
    TableColumns,
)
from needleforce.recordings.text_lines import TextLines
from needleforce.recordings.text_table import (
    COMMENT,
    WHITE_SPACE,
    NumberedLine,
    TableStart,
    find_table,
    split_line,
)
from needleforce.recordings.time_stamps import (
    exceed_float64,
    first_valid_stamp,
    start_of_clock,
    to_seconds,
)
from needleforce.recordings.written_numbers import (
    UNKNOWN_NS,
    is_list,
    is_number,
    list_numbers,
    meaning_of_commas,
    read_clock_ns,
    read_clocks_ns,
    read_lists,
    read_number,
)

CSV_SUFFIXES = (
    ".csv",
    ".csv.gz",
    ".tsv",
    ".tsv.gz",
    ".txt",
    ".txt.gz",
    ".dat",
    ".asc",
    ".lvm",
)


class _Rows:
    """Reads the rows of a table, column by column.

    What a column holds is decided from the first rows that are read: numbers, times,
    lists of numbers; or text, and it is left out. Rows with another number of cells
    than the header are left out.

    Attributes:
        start: How the table begins.
        faults: What is wrong with rows and cells.
        joint_groups: See `find_joint_groups`.
        notes: Why columns are left out, but those that name joints.
        clocks: Columns of times, which are read in seconds, with their latest time.
        start_ns: The instant of t = 0, see `Table`.
    """

    def __init__(
        self, start: TableStart, head: Sequence[NumberedLine], knowledge: Knowledge
    ) -> None:
        self.start = start
        self.faults = FaultCounts()
        self.joint_groups: dict[str, dict[str, str]] = {}
        self.notes: list[str] = []
        self.start_ns = 0
        self._knowledge = knowledge
        self._commas = meaning_of_commas(
            cell for line in head for cell in split_line(line.text, start.delimiter)
        )
        self.clocks: dict[str, int | None] = {}
        self._lists: dict[str, int] = {}  # with their width
        self._kept: list[str] = []  # names of the columns that are read

    def read(self, lines: Sequence[NumberedLine]) -> TableColumns:
        """Return the columns of rows; the first ones decide what each holds.

        Raises:
            FormatError: No row of these, or no column, can be read.
        """
        columns = self._read_at_once(lines) or self._read_cells(lines)
        group_of = {
            name: group
            for group, members in self.joint_groups.items()
            for name in members.values()
        }
        grouped: dict[str, np.ndarray] = {}
        for name, values in columns.items():
            group = group_of.get(name)
            if group is None:
                values.setflags(write=False)
                grouped[name] = values
            elif group not in grouped:
                members = self.joint_groups[group].values()
                grouped[group] = np.stack([columns[each] for each in members], axis=1)

        return grouped

    def _read_at_once(
        self, lines: Sequence[NumberedLine]
    ) -> dict[str, np.ndarray] | None:
        """Return the columns of rows if every cell is a number, else None.

        This takes half the time of reading column by column.
        """
        names = list(self.start.names)
        if self._kept != names or self.clocks or self._lists:
            return None

        delimiter = self.start.delimiter
        try:
            values = np.loadtxt(
                [text for _, text in lines],
                delimiter=None if delimiter == WHITE_SPACE else delimiter,
                comments=None,
                ndmin=2,
            )
        except ValueError:
            return None

        if values.shape[1] != len(names) or exceed_float64(values):
            return None

        return dict(zip(names, values.T.copy(), strict=True))

    def _read_cells(self, lines: Sequence[NumberedLine]) -> dict[str, np.ndarray]:
        """Return the columns of rows, cell by cell."""
        numbers, rows = self._split(lines)
        columns_of_cells = list(zip(*rows, strict=True))
        columns_of_cells = columns_of_cells or [()] * len(self.start.names)
        cells_of = dict(zip(self.start.names, columns_of_cells, strict=True))
        if not self._kept:
            self._choose(cells_of, numbers)

        columns: dict[str, np.ndarray] = {}
        for name in self._kept:
            if name in self.clocks:
                columns[name] = self._read_clocks(name, cells_of[name], numbers)
            elif name in self._lists:
                columns[name] = read_lists(cells_of[name], self._lists[name])
            else:
                columns[name] = self._read_numbers(name, cells_of[name], numbers)

        return columns

    def _split(
        self, lines: Sequence[NumberedLine]
    ) -> tuple[list[int], list[list[str]]]:
        """Return the numbers and the cells of rows that have the header's cells."""
        width = len(self.start.names)
        numbers: list[int] = []
        rows: list[list[str]] = []
        for number, text in lines:
            cells = split_line(text, self.start.delimiter)
            while len(cells) > width and not cells[-1].strip():
                cells.pop()

            if "\0" in text:
                self.faults.note("rows with NUL bytes, left out", f"line {number}")
            elif len(cells) != width:
                self.faults.note(
                    f"rows without the header's {width} cells, left out",
                    f"line {number} with {len(cells)}",
                )
            else:
                numbers.append(number)
                rows.append(cells)

        return numbers, rows

    def _choose(
        self, cells_of: Mapping[str, Sequence[str]], numbers: list[int]
    ) -> None:
        """Decide from the first rows what each column holds."""
        if not numbers:
            fault, (_, first) = next(iter(self.faults.items()))
            raise FormatError(f"no row can be read: {fault} (first: {first})")

        omitted: dict[str, str] = {}
        for name, cells in cells_of.items():
            filled = [cell for cell in cells if cell.strip()]
            widths = [len(list_numbers(cell)) for cell in filled if is_list(cell)]
            if any(map(is_number, cells)):
                continue
            if filled and all(read_clock_ns(cell) is not None for cell in filled):
                self.clocks[name] = None
            elif (
                filled
                and len(widths) == len(filled)
                and max(widths) <= MAX_LIST_NUMBERS
            ):
                self._lists[name] = Counter(widths).most_common(1)[0][0]
            elif filled:
                line = numbers[cells.index(filled[0])]
                omitted[name] = f"holds text (line {line}, {filled[0].strip()[:40]!r})"
            else:
                omitted[name] = "is empty"

        notes = {
            name: f"column {name!r} {reason} and was left out"
            for name, reason in omitted.items()
        }
        if len(omitted) == len(cells_of):
            raise FormatError(
                f"no column holds a number: {'; '.join(notes.values())[:500]}"
            )

        texts = {name: cells_of[name][0].strip() for name in omitted}
        kept = [name for name in cells_of if name not in omitted]
        rules = self._knowledge.joints
        self.joint_groups, sources = find_joint_groups(kept, texts, rules)
        self.notes = [note for name, note in notes.items() if name not in sources]
        self._kept = kept

    def _read_clocks(
        self, name: str, cells: Sequence[str], numbers: Sequence[int]
    ) -> np.ndarray:
        """Return a column of times in seconds, NaN where there is none."""
        stamps_ns = read_clocks_ns(cells, self.clocks[name])
        is_known = stamps_ns != UNKNOWN_NS
        for row in np.flatnonzero(~is_known).tolist():
            self._note_cell(name, cells[row], numbers[row])

        if is_known.any():
            if self.clocks[name] is None:
                first_ns = first_valid_stamp(stamps_ns[is_known])
                self.start_ns = self.start_ns or start_of_clock(first_ns)

            self.clocks[name] = int(stamps_ns[is_known][-1])

        return np.where(is_known, to_seconds(stamps_ns, self.start_ns), nan)

    def _read_numbers(
        self, name: str, cells: Sequence[str], numbers: Sequence[int]
    ) -> np.ndarray:
        """Return a column of numbers, NaN where there is none; count what is odd."""
        try:
            if "_" in "".join(cells):
                raise ValueError  # 1_0 is 10 for Python, and damage in a file

            values = np.fromiter(map(float, cells), np.float64, len(cells))
        except ValueError:
            found = [
                self._number(name, cell, line)
                for cell, line in zip(cells, numbers, strict=True)
            ]
            return np.array(found, dtype=np.float64)

        if exceed_float64(values):
            with suppress(ValueError, OverflowError):  # some are no whole numbers
                return np.array([int(cell) for cell in cells], dtype=np.int64)

        return values

    def _number(self, name: str, cell: str, line: int) -> float:
        """Return the number in a cell, NaN if there is none; count what is odd."""
        value = read_number(cell, self._commas)
        if value is None:
            self._note_cell(name, cell, line)
            return nan
        if "," in cell:
            self.faults.note(self._commas.value, f"line {line}")

        return value

    def _note_cell(self, name: str, cell: str, line: int) -> None:
        """Count a cell of text where there should be a number."""
        if text := cell.strip():
            self.faults.note(
                f"column {name!r}: cells that are not numbers, read as NaN",
                f"line {line}, {text[:40]!r}",
            )


def find_joint_groups(
    names: Iterable[str], texts: Mapping[str, str], rules: JointRules
) -> tuple[dict[str, dict[str, str]], set[str]]:
    """Find the joints that text exported from ROS topics names.

    A message of joint states holds names, positions, velocities and efforts. Tools that
    export it to text write one column for each joint, in one of the ways that
    `[joints]` in `layouts.toml` lists. These columns become one of two dimensions.

    Args:
        names: Of all columns of numbers.
        texts: Of each column of text, what its first row holds.
        rules: How names of columns are made.

    Returns:
        By name of the column that they become: the columns by joint. And the columns
        of text that state names of joints.
    """
    by_path: dict[str, dict[str, str]] = {}
    for name in names:
        if match := re.match(rules.by_path, name):
            group = match["head"] + match["field"]
            by_path.setdefault(group, {})[match["joint"]] = name

    named: dict[str, dict[str, str]] = {}  # joints by number, by what is before `name`
    head_of: dict[str, str] = {}
    for name, text in texts.items():
        listed = re.findall(r"['\"]([^'\"]+)['\"]", text)
        if match := re.match(rules.by_number, name):
            head_of[name] = match["head"]
            named.setdefault(match["head"], {})[match["number"]] = text
        elif len(listed) > 1 and (match := re.match(rules.by_list, name)):
            head_of[name] = match["head"]
            named[match["head"]] = {str(n): joint for n, joint in enumerate(listed)}

    groups = {group: members for group, members in by_path.items() if len(members) > 1}
    used: set[str] = set()
    for (head, joint_of), field in product(named.items(), rules.fields):
        expression = re.compile(rf"{re.escape(head + field)}_?\[?(\d{{1,3}})\]?")
        matches = filter(None, map(expression.fullmatch, names))
        column_of = {match[1]: match[0] for match in matches}
        if column_of.keys() == joint_of.keys():
            members = {joint: column_of[n] for n, joint in joint_of.items()}
            groups[head.replace(".", "/") + field] = members
            used |= {name for name, each in head_of.items() if each == head}

    return groups, used


class _CsvText:
    """Sorts lines into what stands above the table, comments and rows.

    Lines starting with `#` are comments. Whatever the pieces in which lines come, the
    table is looked for after the same numbers of them.

    Attributes:
        rows: The reader of the table; None before it has been found.
        head: Its first rows, once they are read.
        waiting: Rows that wait to be read; before the table has been found all lines.
    """

    def __init__(self, knowledge: Knowledge) -> None:
        self.rows: _Rows | None = None
        self.head: Table | None = None
        self.waiting: list[NumberedLine] = []
        self._start_ns = 0
        self._knowledge = knowledge
        # Two comments above the first row may hold its names and units.
        self._comments: deque[NumberedLine] = deque(maxlen=2)
        # After so many lines the table is looked for; the last time it must be there.
        self._looks = [HEAD_ROWS + 1, HEAD_ROWS + 50, 400, 800, 1600, 3200, 5000]
        self._line_count = 0
        self._latest_row_line = 0

    def add(self, lines: Sequence[str]) -> None:
        """Add whole lines.

        Raises:
            FormatError: There is no table, or no row, in very many lines.
        """
        for number, line in enumerate(lines, self._line_count + 1):
            if _is_row(line):
                self.waiting.append(NumberedLine(number, line))
            elif not self.waiting and line.strip():
                self._comments.append(NumberedLine(number, line))
                if match := re.match(
                    rf"{COMMENT}\s*{START_KEY}\s*=\s*(-?\d{{1,19}})\s*$", line
                ):
                    self._start_ns = int(match[1])

        self._line_count += len(lines)
        if self.waiting:
            self._latest_row_line = self.waiting[-1].number

        # A megabyte of gzip can hold a thousand million line ends.
        max_count = 1_000_000
        if self._line_count - self._latest_row_line > max_count:
            raise FormatError(
                f"{max_count} lines after line {self._latest_row_line} are blank or "
                "comments; it is damaged, or no table"
            )

        self._look_for_table()

    def _look_for_table(self) -> None:
        """Find the table, if enough lines have come to tell."""
        while self.rows is None and len(self.waiting) >= self._looks[0]:
            first_lines = self.waiting[: self._looks.pop(0)]
            if not self._looks:
                self._begin(first_lines)
                break

            with suppress(FormatError):
                self._begin(first_lines, HEAD_ROWS)

    def _begin(self, lines: Sequence[NumberedLine], min_rows: int = 0) -> None:
        """Find the table in the first lines; what stands above it goes.

        It is not taken if so few of its rows are there that it may be another one.
        """
        start = find_table(lines, self._comments, self._knowledge)
        if start.row_count >= min_rows:
            self.waiting = self.waiting[start.first_row :]
            self.rows = _Rows(start, self.waiting[:HEAD_ROWS], self._knowledge)
            self.rows.start_ns = self._start_ns

    def end(self, tail: str, *, is_growing: bool) -> None:
        """Add what stands behind the last line end.

        It is a row if it has the header's cells: whether its last number is cut cannot
        be known, unless the file was still being written.

        Raises:
            FormatError: There is no table.
        """
        if self.rows is None:
            with suppress(FormatError):
                self._begin(self.waiting)

        if self.rows is not None and _is_row(tail):
            start = self.rows.start
            cell_count = len(split_line(tail, start.delimiter))
            if cell_count < len(start.names) or is_growing:
                self.rows.faults.note(
                    f"line {self._line_count + 1}, the last, is cut short "
                    f"({cell_count} of {len(start.names)} cells) and was left out",
                    "",
                )
                tail = ""

        self.add([tail])
        if self.rows is None:
            self._begin(self.waiting)

    def ready(self, *, is_last: bool = False) -> Iterator[Table]:
        """Yield the rows that can be read by now: the first ones apart, then all."""
        rows = self.rows
        has_head = is_last or len(self.waiting) >= HEAD_ROWS
        if rows is not None and self.head is None and has_head:
            columns = rows.read(self.waiting[:HEAD_ROWS])
            self.waiting = self.waiting[HEAD_ROWS:]
            groups = rows.joint_groups.items()
            self.head = Table(
                columns=columns,
                joint_names={group: tuple(members) for group, members in groups},
                start_ns=rows.start_ns,
                seconds=frozenset(rows.clocks),
                warnings=(*rows.start.warnings, *rows.notes),
                units=rows.start.units,
                has_header=rows.start.has_header,
                layout=rows.start.layout,
            )
            yield self.head
        if rows is not None and self.head is not None and self.waiting:
            columns = rows.read(self.waiting)
            self.waiting = []
            yield replace(self.head, columns=columns, warnings=())


def _is_row(line: str) -> bool:
    """Return whether a line is neither blank nor a comment."""
    return line[:1] not in ("", COMMENT) and not line.isspace()


def csv_tables(
    blocks: Iterable[bytes],
    name: str,
    options: FollowOptions | None = None,
    max_bytes: int = MAX_BYTES,
    knowledge: Knowledge = KNOWLEDGE,
) -> Iterator[Table]:
    """Read CSV text in blocks as it comes: a header row, then rows of numbers.

    Args:
        blocks: The text, plain or compressed with gzip.
        name: Of the source, for errors.
        options: A source that grows may end in the middle of a line that is being
            written.
        max_bytes: The most memory that rows may take before they are read.
        knowledge: Names, units and layouts that are known.

    Yields:
        Tables of consecutive rows with equal columns, the first of `HEAD_ROWS` rows if
        there are so many; then one without rows, whose warnings report all that was
        wrong.

    Raises:
        FormatError: It is no such text, or has too long lines.
    """
    lines = TextLines(blocks, knowledge)
    text = _CsvText(knowledge)
    options = options or FollowOptions()
    row_bytes = 100  # that Python adds to the text of a row
    read_bytes = 0
    try:
        for batch in lines:
            text.add(batch)
            for table in text.ready():
                yield table
                read_bytes = lines.size

            waiting_bytes = lines.size - read_bytes + row_bytes * len(text.waiting)
            require_size(waiting_bytes, max_bytes, "its text")

        if options.should_stop():
            lines.forgive_end()

        text.end(lines.tail, is_growing=options.follow)
        yield from text.ready(is_last=True)
    except FormatError as error:
        losses = "".join(f" ({warning})" for warning in lines.warnings)
        raise error.reworded(f"{name}: {error}{losses}") from error

    assert text.rows is not None
    assert text.head is not None
    no_rows = {column: values[:0] for column, values in text.head.columns.items()}
    warnings = (*lines.warnings, *text.rows.faults.lines())
    yield replace(text.head, columns=no_rows, warnings=warnings)
