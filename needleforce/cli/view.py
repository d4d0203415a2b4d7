"""The command `needleforce view`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from needleforce.cli.application import LIVE_OUTPUT, LOG, LOGS, TARE, app
from needleforce.cli.shared_options import TARE_S, RobotOptions


@Parameter(name="*", group=LOG)
@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """What is shown beside a recording, and where.

    Attributes:
        anatomy: Plan (plan.json, or its folder) with labels.nii.gz (or .nrrd,
            .seg.nrrd): see docs/how-to/scene.md.
        situs_inversus: Liver and spleen of this patient are exchanged.
        mapping: TOML file that says which columns are which, as `needleforce force
            --print-config` writes.
        tare: Tare after so many seconds of motion without contact (default: 4); if it
            is refused, again after as many.
        export: Write the scene as one page (.html) with the insertion as a film, and
            end.
        port: Port of the page, on this machine alone (default: 8080); another is used
            if it is busy.
    """

    anatomy: Annotated[
        Path | None, Parameter(name=("--anatomy", "--plan"), metavar="DIR|FILE")
    ] = None
    situs_inversus: Annotated[bool, Parameter(negative="")] = False
    mapping: Annotated[str | None, Parameter(metavar="FILE")] = None
    tare: Annotated[float, Parameter(metavar="S", group=TARE)] = TARE_S
    export: Annotated[Path | None, Parameter(metavar="FILE", group=LIVE_OUTPUT)] = None
    port: Annotated[int, Parameter(metavar="N", group=LIVE_OUTPUT)] = 8080


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

    return view_recording(
        recording,
        robot,
        port=options.port,
        export=options.export,
        tare_s=options.tare,
        mapping=options.mapping,
        anatomy=options.anatomy,
        situs_inversus=options.situs_inversus,
    )
