"""The option ``--plan`` of commands that follow a plan."""

from pathlib import Path

from needleforce.cli.terminal import CommandError, progress_bar, warn
from needleforce.plan_file import LoadedPlan, read_plan


def load_plan(
    place: Path | None, *, is_past: bool = False, situs_inversus: bool = False
) -> LoadedPlan | None:
    """Return a plan from its file, and say its warnings on stderr; see `read_plan`.

    Without a file there is no plan.

    Raises:
        CommandError: A situs inversus is stated of no plan.
        needleforce.plan_file.PlanFileError: As `read_plan`.
    """
    if place is None:
        if situs_inversus:
            raise CommandError(
                "--situs-inversus belongs to the labels of a plan: expected --plan"
            )
        return None
    with progress_bar("surfaces") as progress:
        plan = read_plan(
            place, is_past=is_past, situs_inversus=situs_inversus, progress=progress
        )
    warn(plan.warnings)
    return plan
