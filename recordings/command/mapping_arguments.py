"""Column mappings on the command line, the same for every command."""

from argparse import ArgumentParser, Namespace
from collections.abc import Iterable
from dataclasses import replace

from recordings.columns.channel import CHANNELS
from recordings.columns.mapping import ColumnMapping
from recordings.columns.mapping_file import load_mapping
from recordings.columns.spec import parse_column_spec

_DESCRIPTION = (
    "COLUMNS is a column name, a pattern such as q{1..7} or q_*, or names separated by commas; "
    "a unit and a factor may follow, as in z:mm or fz:N:-1. What is not given is found by its "
    "usual names."
)


def mapping_arguments(parser: ArgumentParser, channels: Iterable[str]) -> None:
    """Add the options that say which columns are which channels.

    Args:
        parser: the command's parser.
        channels: the channels this command reads, apart from time.
    """
    group = parser.add_argument_group("columns", _DESCRIPTION)
    for name in ("time", *channels):
        channel = CHANNELS[name]
        group.add_argument(
            f"--{name}",
            dest=f"columns_of_{name}",
            metavar="COLUMNS",
            help=f"{channel.meaning} ({', '.join(channel.units)})",
        )
    group.add_argument(
        "--rate", dest="rate_hz", type=float, metavar="HZ", help="sample rate when there is no time"
    )
    group.add_argument(
        "--mapping", dest="mapping_file", metavar="FILE", help="TOML file that says all this"
    )
    group.add_argument(
        "--print-config",
        action="store_true",
        help="print such a file for this log, to be edited, and stop",
    )


def mapping_from_arguments(arguments: Namespace) -> ColumnMapping:
    """Return the mapping that options and mapping file give together; options win.

    Args:
        arguments: what a parser with `mapping_arguments` returned.

    Returns:
        The mapping.

    Raises:
        FileAccessError: the mapping file cannot be read.
        MappingError: the file or an option is not valid.
    """
    base = load_mapping(arguments.mapping_file) if arguments.mapping_file else ColumnMapping()
    given = {
        name: parse_column_spec(text, channel)
        for name, channel in CHANNELS.items()
        if (text := getattr(arguments, f"columns_of_{name}", None)) is not None
    }
    channels = {**base.channels, **given}
    rate_hz = arguments.rate_hz
    if rate_hz is not None and "time" not in given:
        channels.pop("time", None)
    if rate_hz is None and "time" not in given:
        rate_hz = base.rate_hz
    return replace(base, channels=channels, rate_hz=rate_hz)
