"""The tare that `live` and `view` take by themselves."""

import math

from needleforce.cli.terminal import CommandError, say
from needleforce.tare_run import AutoTare
from residual import TareError


def auto_tare(every_s: float, *, at_once: bool = False) -> AutoTare:
    """Return a tare that says on stderr why it was refused.

    Args:
        every_s: Motion before the first tare, and between two attempts.
        at_once: Whether the log is a recording, in which no tick waits.

    Raises:
        CommandError: The time is not positive, or infinite.
    """
    if not 0.0 < every_s < math.inf:
        raise CommandError(f"--tare {every_s:g}: expected seconds of free motion")

    def say_refusal(time_s: float, error: TareError) -> None:
        say(
            f"no tare at {time_s:.1f} s: {error}; keep the needle free, the next "
            "attempt follows by itself"
        )

    return AutoTare(every_s, at_once=at_once, on_refusal=say_refusal)
