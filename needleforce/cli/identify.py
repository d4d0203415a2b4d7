"""The command `needleforce identify`."""

from needleforce.cli.application import LOGS, app
from needleforce.cli.shared_options import (
    DepthColumns,
    IdentificationOptions,
    Output,
    Source,
)


@app.command(name="identify", group=LOGS)
def identify_command(
    log: Source,
    /,
    *,
    output: Output = Output(),
    options: IdentificationOptions = IdentificationOptions(),
    columns: DepthColumns = DepthColumns(),
) -> int:
    """Identify ruptures, layers, stiffness and friction from depth and axial force.

    Read a log with time, depth, force and perhaps speed. Depth grows into the tissue;
    force is positive when tissue pushes back. Times are on the log's clock. A ? marks
    values that the data do not identify.

    needleforce identify forces.csv -o layers.csv --figure layers.png
    """
    from needleforce.cli.logs.replay import identify

    return identify(log, output, options, columns)
