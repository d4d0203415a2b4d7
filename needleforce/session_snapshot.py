"""State of a session: what it holds, and which states are refused."""

from typing import TYPE_CHECKING, NamedTuple

from foundation.errors import NeedleforceError
from foundation.state import OWN_SNAPSHOT, SAME_KIND, SAME_SETTINGS
from identification import (
    IdentificationError,
    Identifier,
    MixtureConfig,
    PublishedConfig,
)
from identification import Snapshot as IdentifierSnapshot
from needleforce.insertion_course import InsertionProgress
from needleforce.needle_channels import NeedleChannel
from needleforce.plan_follower import PlanFollower, PlanMemory
from needleforce.rewinding import Checkpoints
from needleforce.tip_travel import TipTravel, TravelZero
from needleforce.zero_watch import AirWatch
from residual.virtual_force_sensor import SensorState

if TYPE_CHECKING:
    from needleforce.anatomy import PlanState


class InsertionError(NeedleforceError):
    """Base of a session's errors.

    Errors of `residual` and `identification` pass through a session unchanged.
    """

    usual_advice = (
        "Give what the message expects; `load_lwr` and `load_urdf` make a robot, "
        "`SensorConfig` holds the settings of the sensor."
    )


class SnapshotMismatchError(InsertionError, ValueError):
    """A snapshot that cannot be restored here; nothing has changed."""

    usual_advice = "Take an older snapshot, or start and tare anew."


class SnapshotFileError(InsertionError, ValueError):
    """A file that is no snapshot, or one of a version that cannot be read."""

    usual_advice = OWN_SNAPSHOT


class SessionSnapshot(NamedTuple):
    """Complete state of an `InsertionSession`; immutable.

    Attributes:
        sensor: State of the virtual sensor.
        identifier: State of the identifier.
        zero: Where depth counts from.
        travel: Depth and speed of the tip.
        speed_lag_s: Setting of the session.
        unused_s: Time of valid samples that were not used for identification.
        jumps: Number of jumps of torque sensors that the identifier knows of.
        jump_std_N: Standard deviation of the axial force due to these jumps; 0 without
            one.
        time_s: See `SessionEstimate`.
        checkpoints: States of the identification to rewind to.
        insertion: Course of this insertion.
        channels: Those that earlier insertions have cut.
        plan: State of the plan's follower.
        air: What the force in free air has shown.
    """

    sensor: SensorState
    identifier: IdentifierSnapshot
    zero: TravelZero
    travel: TipTravel
    speed_lag_s: float
    unused_s: float
    jumps: int
    jump_std_N: float
    time_s: float
    checkpoints: Checkpoints
    insertion: InsertionProgress
    channels: tuple[NeedleChannel, ...]
    plan: PlanMemory
    air: AirWatch


def check_snapshot(
    snapshot: SessionSnapshot,
    here: SessionSnapshot,
    config: MixtureConfig | PublishedConfig,
    plan: PlanFollower,
) -> "PlanState | None":
    """Refuse a snapshot that does not fit a session, or would fail in later updates.

    The sensor checks its own part.

    Args:
        snapshot: What is to be restored.
        here: A snapshot of the session.
        config: Settings of the session's identifier.
        plan: The session's.

    Returns:
        The state of the plan that belongs to the snapshot.

    Raises:
        SnapshotMismatchError: No snapshot of a session, a damaged one, or one of
            another speed lag or plan.
        IdentificationError: One of other settings of the identifier.
    """
    _check_kind_and_settings(snapshot, here)
    try:
        _check_identifiers(snapshot, config)
        return plan.evaluate(snapshot.plan)
    except IdentificationError:
        raise
    except Exception as error:  # the parts of a damaged state may raise anything
        raise SnapshotMismatchError(f"the snapshot is damaged: {error!r}") from error


def _check_kind_and_settings(snapshot: SessionSnapshot, here: SessionSnapshot) -> None:
    """Refuse what is no snapshot of a session with these settings and this plan."""
    if not isinstance(snapshot, SessionSnapshot):
        raise SnapshotMismatchError(
            f"expected a SessionSnapshot, got {type(snapshot).__name__}",
            SAME_KIND,
        )
    if not (
        isinstance(snapshot.plan, PlanMemory)
        and isinstance(snapshot.checkpoints, Checkpoints)
    ):
        raise SnapshotMismatchError("the snapshot is damaged: plan or checkpoints")
    if snapshot.speed_lag_s != here.speed_lag_s:
        raise SnapshotMismatchError(
            f"the snapshot is of speed_lag_s {snapshot.speed_lag_s:g}, this "
            f"session has {here.speed_lag_s:g}",
            SAME_SETTINGS,
        )
    if snapshot.plan.fingerprint != here.plan.fingerprint:
        difference = (
            "with another plan or entry"
            if snapshot.plan.fingerprint
            else "without a plan"
        )
        raise SnapshotMismatchError(
            f"the snapshot is of a session {difference}",
            "Call `follow` with the plan of the snapshot, or None, before `restore`.",
        )


def _check_identifiers(
    snapshot: SessionSnapshot, config: MixtureConfig | PublishedConfig
) -> None:
    """Restore each state of an identifier in a trial one, and update the last."""
    trial_step_s = 1e-3  # Time step of these updates
    trial_updates = 3  # Updates that a restored identifier must survive
    trial = Identifier(config)
    trial.restore(snapshot.checkpoints.older.identifier)
    trial.restore(snapshot.checkpoints.newer.identifier)
    for channel in snapshot.channels:
        trial.restore(channel.identifier)
    if snapshot.insertion.channel is not None:
        trial.restore(snapshot.insertion.channel.in_air)
    trial.restore(snapshot.identifier)
    travel = snapshot.travel
    for _ in range(trial_updates):
        trial.update(travel.depth_m, travel.speed_m_s, 0.0, trial_step_s)
