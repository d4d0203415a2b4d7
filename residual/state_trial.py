"""Tries a state out on a sensor that nobody uses, before one that somebody uses takes it."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from residual.errors import SnapshotError
from residual.sensor_state import SensorState
from residual.state_form import check_form

if TYPE_CHECKING:
    from residual.virtual_force_sensor import VirtualForceSensor

TRIED_S = 0.03
"""Time step of a trial: long enough that everything which changes slowly is renewed."""
TRIED = 3


def try_out(
    twin: "VirtualForceSensor", take: Callable[[SensorState], None], state: SensorState
) -> None:
    """Make a damaged state fail now and not in a later update.

    Args:
        twin: A new sensor of the same robot and settings.
        take: Makes the twin go on from a state.
        state: What is to be restored.

    Raises:
        SnapshotError: If the state is damaged.
    """
    try:
        if state.joints is not None and state.external_torque is not None:
            raise SnapshotError("it is of two streams")
        still = np.zeros_like(twin.velocity_rad_s)
        _run(twin, state, still, still, still)
        check_form(state, twin.snapshot())
        take(state)
        torque = still if state.offset.smooth_torque is None else state.offset.smooth_torque
        _run(twin, state, state.offset.q, state.velocity, torque)
    except Exception as error:  # whatever a damaged state makes of its parts
        raise SnapshotError(f"the snapshot is damaged: {error}") from error


def _run(
    twin: "VirtualForceSensor",
    state: SensorState,
    q: NDArray[np.float64],
    dq: NDArray[np.float64],
    torque: NDArray[np.float64],
) -> None:
    """A few samples of the kind that the state is of."""
    for _ in range(TRIED):
        if state.joints is not None:
            given = state.joints.torque.velocity is None
            found = twin.update(q, dq if given else None, torque, TRIED_S)
        elif state.external_torque is not None:
            given = state.external_torque.velocity is None
            found = twin.update_external_torque(q, torque, TRIED_S, dq if given else None)
        else:
            return
        if not np.isfinite((found.axial, found.axial_std, found.misfit)).all():
            raise SnapshotError("its estimates are not finite")
