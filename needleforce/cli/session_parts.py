"""What commands add to a session: a tare that it takes by itself, and a plan."""

from pathlib import Path

from needleforce.cli.terminal import progress_bar, say, warn
from needleforce.plan_file import LoadedPlan, read_plan
from needleforce.tare_run import AutoTare
from residual import TareError


def auto_tare(every_s: float, *, at_once: bool = False) -> AutoTare:
    """Return a tare that says on stderr why it was refused.

    Args:
        every_s: Motion before the first tare, and between two attempts.
        at_once: Whether the log is a recording, in which no tick waits.
    """

    def say_refusal(time_s: float, error: TareError) -> None:
        say(
            f"no tare at {time_s:.1f} s: {error}; keep the needle free, the next "
            "attempt follows by itself"
        )

    return AutoTare(every_s, at_once=at_once, on_refusal=say_refusal)


def load_plan(place: Path | None, *, is_past: bool = False) -> LoadedPlan | None:
    """Return a plan from its file, and say its warnings on stderr; see `read_plan`.

    Without a file there is no plan.

    Raises:
        needleforce.plan_file.PlanFileError: As `read_plan`.
    """
    if place is None:
        return None
    with progress_bar("surfaces") as progress:
        plan = read_plan(place, is_past=is_past, progress=progress)
    warn(plan.warnings)
    return plan
