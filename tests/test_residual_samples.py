"""What is no sample of real numbers is refused by every estimator alike, without a warning."""

import warnings
from fractions import Fraction

import numpy as np
import pytest
from residual_signals import MIDDLE

from residual import (
    KalmanObserver,
    MomentumObserver,
    SampleError,
    Status,
    VelocityEstimator,
    VirtualForceSensor,
    WrenchEstimator,
)

STILL = np.zeros(7)
NO_NUMBERS = {
    "complex": STILL + 0j,
    "text": np.array(["0.1"] * 7),
    "list of text": ["0.1"] * 7,
    "bytes": np.array([b"1"] * 7),
    "truth values": np.zeros(7, dtype=bool),
    "list of truth values": [True] * 7,
    "objects": np.array([None] * 7),
    "truth values as objects": np.array([False] * 7, dtype=object),
    "masked": np.ma.array(STILL, mask=[True] + [False] * 6),
    "dates": np.array(["2026"] * 7, dtype="datetime64[Y]"),
    "beyond all floats": [10**400] * 7,
    "ragged": [[0.0], [0.0, 1.0]],
}
BEYOND = {
    "NaN": np.r_[np.nan, STILL[1:]],
    "infinite": np.r_[STILL[1:], np.inf],
    "not plausible": STILL + 1e10,
    "hardly a number": STILL + 1e300,
}


def kalman(robot):
    noise = {"torque_noise_Nm": 0.1, "velocity_noise_rad_s": 0.01, "walk_Nm_per_sqrt_s": 1.0}
    return KalmanObserver(robot, **noise)


UPDATES = {
    "velocity, q": lambda robot, bad: VelocityEstimator(7).update(bad, STILL, 1e-3),
    "velocity, tau": lambda robot, bad: VelocityEstimator(7).update(STILL, bad, 1e-3),
    "momentum, q": lambda robot, bad: MomentumObserver(robot).update(bad, STILL, STILL, 1e-3),
    "momentum, dq": lambda robot, bad: MomentumObserver(robot).update(STILL, bad, STILL, 1e-3),
    "momentum, tau": lambda robot, bad: MomentumObserver(robot).update(STILL, STILL, bad, 1e-3),
    "Kalman, q": lambda robot, bad: kalman(robot).update(bad, STILL, STILL, 1e-3),
    **{
        f"{mode} wrench, {name}": lambda robot, bad, mode=mode, name=name: WrenchEstimator(
            robot, mode
        ).estimate(**({"q": MIDDLE, "residual": STILL} | {name: bad}))
        for mode in ("axial", "point", "full")
        for name in ("q", "residual")
    },
}


@pytest.mark.parametrize("update", UPDATES)
@pytest.mark.parametrize("kind", NO_NUMBERS)
def test_what_is_no_real_number_is_refused(lwr, update, kind):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(SampleError, match=update.split()[-1]):
            UPDATES[update](lwr, NO_NUMBERS[kind])


@pytest.mark.parametrize("update", UPDATES)
@pytest.mark.parametrize("kind", BEYOND)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_what_no_sensor_measures_is_refused(lwr, update, kind):
    with pytest.raises(SampleError, match=update.split()[-1]):
        UPDATES[update](lwr, BEYOND[kind])


@pytest.mark.parametrize("update", UPDATES)
@pytest.mark.parametrize(
    "sound",
    [
        [0.0] * 7,
        [0] * 7,
        STILL.astype(np.float32),
        STILL.astype(int),
        [Fraction(0)] * 7,
        np.ma.array(STILL),
    ],
)
def test_real_numbers_of_any_type_are_welcome(lwr, update, sound):
    assert str(UPDATES[update](lwr, sound)) == str(UPDATES[update](lwr, STILL))


@pytest.mark.parametrize("dt_s", [10**400, -(10**400), True, 1j, "0.001", None])
def test_a_time_step_that_is_none_is_refused(lwr, dt_s):
    observer, velocity = MomentumObserver(lwr), VelocityEstimator(7)
    sensor = VirtualForceSensor(lwr)
    observer.update(STILL, STILL, STILL, 1e-3)
    velocity.update(STILL, STILL, 1e-3)
    sensor.update(STILL, STILL, STILL, 1e-3)
    with pytest.raises(SampleError, match="dt_s"):
        observer.update(STILL, STILL, STILL, dt_s)
    with pytest.raises(SampleError, match="dt_s"):
        velocity.update(STILL, STILL, dt_s)
    assert sensor.update(STILL, STILL, STILL, dt_s).status is Status.REJECTED
    assert sensor.update(STILL, STILL, STILL, 1e-3).status is Status.INITIALIZING
    assert sensor.elapsed_s == 1e-3
