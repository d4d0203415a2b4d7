"""`needleforce identify`: from options and a log to its layers."""

from needleforce.cli.logs.layer_page import LayerPage
from needleforce.cli.logs.layer_result import identify_layers
from needleforce.cli.logs.log_session import LogSession, mapping_from_options
from needleforce.cli.logs.outputs import open_output, run_log
from needleforce.cli.shared_options import DepthColumns, IdentificationOptions, Output
from needleforce.cli.terminal import write_out
from needleforce.recordings import ColumnMapping
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.mapping_suggestion import suggest_mapping
from needleforce.recordings.table import TableLabels

REQUIRED = ("depth", "force")
OPTIONAL = ("speed", "force_std", "force_status", "force_warnings")


def run(
    source: str,
    output: Output,
    options: IdentificationOptions,
    columns: DepthColumns,
) -> int:
    """Identify the layers of a log.

    Args:
        source: The log as the command line names it.
        output: How long it is read, and which files are written.
        options: How forces become layers.
        columns: Which columns are which channels.

    Returns:
        The exit code.
    """
    mapping = mapping_from_options(columns)
    optional = _optional_channels(mapping)
    if columns.print_config:
        write_out(suggest_mapping(source, (*REQUIRED, *optional), mapping=mapping))
        return 0
    request = ChannelRequest(mapping=mapping, required=REQUIRED, optional=optional)

    def estimate(log: LogSession) -> LayerPage:
        labels = TableLabels(prefix="/needleforce/identification")
        with open_output(output, log, labels) as table:
            return LayerPage(identify_layers(log, log.name, options, table))

    return run_log(source, output, request, estimate)


def _optional_channels(mapping: ColumnMapping) -> tuple[str, ...]:
    """Return what is read beside depth and force.

    What `needleforce force` states of the axial force holds for no other force.
    """
    force = mapping.channels.get("force")
    if force is None or "axial" in force.patterns[0].lower():
        return OPTIONAL
    return tuple(
        name for name in OPTIONAL if name == "speed" or name in mapping.channels
    )
