"""The command `needleforce doctor`."""

from typing import Annotated

from cyclopts import Parameter

from needleforce.cli.application import LIVE_OUTPUT, MACHINE, app
from needleforce.cli.terminal import aligned, json_text, write_out


@app.command(name="doctor", group=MACHINE)
def doctor_command(
    *,
    compile: Annotated[
        bool,
        Parameter(
            group=LIVE_OUTPUT,
            help="First compile what is not kept yet, so that no later start has to.",
        ),
    ] = False,
    json: Annotated[bool, Parameter(group=LIVE_OUTPUT, help="Print JSON.")] = False,
) -> int:
    """Print versions, extras, the compiler's cache, and what is in the way of use.

    Unless told to it compiles nothing; it needs no network. For a bug report.

    needleforce doctor --json
    """
    from needleforce.cli.checkup import compile_everything, examine

    if compile:
        compile_everything()
    found = examine()
    write_out(json_text(found) if json else aligned(found.items()))
    return 0
