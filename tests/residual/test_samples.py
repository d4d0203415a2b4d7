"""What is no sample of real numbers is refused by every estimator alike, without a
warning."""

import warnings
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from residual import (
    DEFAULT,
    MomentumObserver,
    SampleError,
    SensorConfig,
    SnapshotError,
    VelocityEstimator,
    VirtualForceSensor,
    WrenchEstimator,
)
from tests.residual.residual_signals import MIDDLE, swing
from urdf import load_lwr

STILL = np.zeros(7)
NO_NUMBERS = {
    "complex": STILL + 0j,
    "text": np.array(["0.1"] * 7),
    "truth values": np.zeros(7, dtype=bool),
    "objects": np.array([None] * 7),
    "masked": np.ma.array(STILL, mask=[True] + [False] * 6),
    "beyond all floats": [10**400] * 7,
}
BEYOND = {
    "NaN": np.r_[np.nan, STILL[1:]],
    "infinite": np.r_[STILL[1:], np.inf],
    "hardly a number": STILL + 1e300,
    "no joint has it": STILL + 1e6,
    "of a smaller arm": STILL[:3],
}

UPDATES = {
    "velocity, q": lambda robot, bad: VelocityEstimator(7).update(bad, STILL, 1e-3),
    "velocity, tau": lambda robot, bad: VelocityEstimator(7).update(STILL, bad, 1e-3),
    "momentum, q": lambda robot, bad: MomentumObserver(robot).update(
        bad, STILL, STILL, 1e-3
    ),
    "momentum, dq": lambda robot, bad: MomentumObserver(robot).update(
        STILL, bad, STILL, 1e-3
    ),
    "momentum, tau": lambda robot, bad: MomentumObserver(robot).update(
        STILL, STILL, bad, 1e-3
    ),
    **{
        f"{mode} wrench, {name}": lambda robot, bad, mode=mode, name=name: (
            WrenchEstimator(robot, SensorConfig(mode=mode)).estimate(
                **({"q": MIDDLE, "residual": STILL} | {name: bad})
            )
        )
        for mode in ("axial", "point", "full")
        for name in ("q", "residual")
    },
}


@pytest.mark.parametrize("update", UPDATES)
@pytest.mark.parametrize("kind", NO_NUMBERS)
def test_what_is_no_real_number_is_refused(lwr, update, kind):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(
            SampleError, match=f"^{update.split()[-1]} is not an array of numbers"
        ):
            UPDATES[update](lwr, NO_NUMBERS[kind])


@pytest.mark.parametrize("update", UPDATES)
@pytest.mark.parametrize("kind", BEYOND)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_what_no_sensor_measures_is_refused(lwr, update, kind):
    words = "(is not finite|reaches|has shape)"
    with pytest.raises(SampleError, match=f"^{update.split()[-1]} {words}"):
        UPDATES[update](lwr, BEYOND[kind])


@pytest.mark.parametrize("update", UPDATES)
@pytest.mark.parametrize(
    "valid", [[0.0] * 7, STILL.astype(np.float32), [Fraction(0)] * 7]
)
def test_real_numbers_of_any_type_are_welcome(lwr, update, valid):
    assert str(UPDATES[update](lwr, valid)) == str(UPDATES[update](lwr, STILL))


# What is unusual and valid is taken; what is damaged is refused before compiled code
# reads it.


STEPS = [1e-3, np.float32(1e-3), np.longdouble(1e-3), Fraction(1, 1000)]


@pytest.mark.parametrize("dt_s", STEPS, ids=[type(one).__name__ for one in STEPS])
def test_time_steps_may_be_any_real_number(lwr, dt_s):
    _, q, dq, tau = swing(lwr, seconds=0.02)
    sensor = VirtualForceSensor(lwr)
    velocity = VelocityEstimator(7)
    for one in zip(q, dq, tau, strict=True):
        wrench = sensor.update(*one, dt_s)
        matched = velocity.update(one[0], one[2], dt_s)

    assert sensor.rejected == 0
    assert sensor.elapsed_s == pytest.approx(1e-3)
    assert type(wrench.axial) is float
    assert np.isfinite(matched.dq).all()


@pytest.mark.parametrize("noise", [np.ones(8), np.zeros(7), np.full(7, np.nan)])
def test_noise_of_another_arm_is_refused(lwr, noise):
    _, q, dq, tau = swing(lwr, seconds=0.7)
    sensor = VirtualForceSensor(lwr)
    for one in zip(q, dq, tau, strict=True):
        sensor.update(*one, 1e-3)
    state = sensor.snapshot()
    damaged = replace(state.stream.observer, noise=noise)

    with pytest.raises(SnapshotError, match="noise"):
        sensor.restore(state._replace(stream=replace(state.stream, observer=damaged)))


@pytest.mark.parametrize("has_velocity", [True, False])
def test_arrays_of_any_layout_are_taken(has_velocity):
    robot = load_lwr()
    _, q, dq, tau = swing(robot, seconds=0.1)
    plain = VirtualForceSensor(robot, DEFAULT)
    strange = VirtualForceSensor(robot, DEFAULT)
    for one in zip(q, dq, tau, strict=True):
        gaps = [np.repeat(row, 2)[::2] for row in one]
        if not has_velocity:
            one = (one[0], None, one[2])
            gaps = (gaps[0], None, gaps[2])
        wrench = plain.update(*one, 1e-3)
        same = strange.update(*gaps, 1e-3)

    assert wrench.axial == same.axial != 0.0
    np.testing.assert_array_equal(wrench.residual, same.residual)
