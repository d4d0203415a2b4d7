"""The command `needleforce doctor`."""

from typing import Annotated

from cyclopts import Parameter

from needleforce.cli.application import LIVE_OUTPUT, MACHINE, app
from needleforce.cli.terminal import write_out


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
    sizes: Annotated[
        bool,
        Parameter(
            group=LIVE_OUTPUT,
            help="Also print the sizes on disk of the core and of what each extra "
            "adds.",
        ),
    ] = False,
    licences: Annotated[
        bool,
        Parameter(
            group=LIVE_OUTPUT,
            help="Print instead a table of the packages that the core and each extra "
            "bring, with their licences.",
        ),
    ] = False,
) -> int:
    """Print versions, extras, compiler and cache, cores, clock, real-time permission.

    Unless told to it compiles nothing; it needs no network. For a bug report.

    needleforce doctor --json
    """
    from needleforce.cli.checkup.compiler import compile_everything
    from needleforce.cli.checkup.distributions import licence_table
    from needleforce.cli.checkup.findings import examine

    if licences:
        write_out(licence_table())
        return 0

    if compile:
        compile_everything()
    found = examine(with_sizes=sizes)
    write_out(found.json() if json else found.text())
    return 0
