"""What a command writes, on its command line; the same for every command that reads a log."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from recordings.errors import FileAccessError
from recordings.write_table import check_writable


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
    """Refuse now what would fail after the work is done.

    Args:
        arguments: of a parser with `source_arguments` and `output_arguments`.

    Raises:
        FileAccessError: a suffix is not known, a folder is not there, or the table would replace
            the log.
    """
    if arguments.output is not None:
        check_writable(arguments.output, source=arguments.log)
    if arguments.png is not None and not Path(arguments.png).parent.is_dir():
        folder = Path(arguments.png).parent
        raise FileAccessError(f"cannot write {arguments.png}: there is no folder {folder}")
