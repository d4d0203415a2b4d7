"""What a command writes, on its command line; the same for every command that reads a log."""

from argparse import ArgumentParser, Namespace
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from recordings.apart import require_apart, require_apart_from_log
from recordings.errors import FileAccessError
from recordings.open_table import STANDARD_STREAM, LabelSource, OpenTable, open_table
from recordings.write_table import check_writable

_PICTURE_SUFFIX = ".png"
_PAGE = "index.html"
"""What stands in the folder of a report, beside charts."""


def output_arguments(parser: ArgumentParser, *, table: str, picture: str, page: str) -> None:
    """Add the options that name the files to write.

    Args:
        parser: the command's parser.
        table: what the table holds, in words.
        picture: what the picture shows.
        page: what the page of the report holds.
    """
    group = parser.add_argument_group("output", "Without any, only a summary is printed.")
    group.add_argument(
        "-o",
        "--output",
        metavar="FILE",
        help=f"table of {table}: .csv, .csv.gz, .npz, ..., or - for CSV on standard output",
    )
    group.add_argument("--png", metavar="FILE", help=picture)
    group.add_argument("--report", type=Path, metavar="DIR", help=f"folder for a page with {page}")


def check_outputs(arguments: Namespace) -> None:
    """Refuse now what would fail, or destroy something, after the work is done.

    Args:
        arguments: of a parser with `source_arguments` and `output_arguments`.

    Raises:
        FileAccessError: a suffix is not known, a folder is not there, or an output would replace
            the log or another output.
    """
    outputs: dict[str, Path] = {}
    if arguments.output is not None:
        check_writable(arguments.output)
        if arguments.output != STANDARD_STREAM:
            outputs["-o"] = Path(arguments.output)
    if arguments.png is not None:
        outputs["--png"] = _picture(Path(arguments.png))
    if arguments.report is not None:
        outputs["--report"] = arguments.report / _PAGE
    if arguments.log != STANDARD_STREAM:
        for path in outputs.values():
            require_apart_from_log(path, Path(arguments.log))
    require_apart(outputs)


def open_output(
    arguments: Namespace, *, is_live: bool, labels: LabelSource
) -> AbstractContextManager[OpenTable | None]:
    """Open the table that the command line names; None is entered if it names none.

    Args:
        arguments: of a parser with `output_arguments`.
        is_live: see `open_table`.
        labels: see `open_table`.
    """
    if arguments.output is None:
        return nullcontext()
    return open_table(arguments.output, is_live=is_live, labels=labels)


def _picture(path: Path) -> Path:
    if not path.parent.is_dir():
        raise FileAccessError(f"cannot write {path}: there is no folder {path.parent}")
    if path.is_dir():
        raise FileAccessError(f"cannot write {path}: it is a folder")
    if path.suffix.lower() != _PICTURE_SUFFIX:
        raise FileAccessError(f"cannot write {path}: a picture's name must end in .png")
    return path
