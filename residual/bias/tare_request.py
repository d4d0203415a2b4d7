"""A tare that is being fitted: what it is fitted to, and how far it has come."""

from dataclasses import dataclass

from residual.bias.model import TareBlocks


@dataclass(slots=True, kw_only=True, eq=False)
class TareRequest:
    """What a tare is fitted to; the fit is a function of it, so a state needs no more.

    Attributes:
        blocks: The recorded motion.
        ignore_contact: Whether contacts are not looked for.
        is_external: Whether torques are the robot's own external ones.
        started_s: Time at which it was asked for, from which its age counts.
        leapt_s: Time in long steps until then, see `BiasState.leapt_s`.
        steps_per_tick: Steps of the fit that are done in a tick.
        done: Steps that are done.
    """

    blocks: TareBlocks
    ignore_contact: bool
    is_external: bool
    started_s: float
    leapt_s: float
    steps_per_tick: int
    done: int = 0

    def find_damage(self) -> str:
        """Return why the counts cannot be; empty if they can."""
        if self.steps_per_tick < 1 or self.done < 0:
            return f"{self.done} steps done, {self.steps_per_tick} per tick"
        return ""
