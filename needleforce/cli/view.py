"""The command `needleforce view`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from needleforce.cli.application import LOG, LOGS, app
from needleforce.cli.shared_options import RobotOptions, ViewOptions


@app.command(name="view", group=LOGS)
def view_command(
    recording: Annotated[Path, Parameter(name="RECORDING", group=LOG)],
    /,
    *,
    options: ViewOptions = ViewOptions(),
    robot: RobotOptions = RobotOptions(),
) -> int:
    """Show a recording of joint signals in a 3-D scene in the browser, until Ctrl-C.

    needleforce view insertion.csv --tare 13
    """
    from needleforce.cli.logs.session_view import view_recording

    return view_recording(recording, options, robot)
