"""Draws the figures of the explanation pages from simulated insertions.

Run it in the project's folder; it takes two minutes:

    python docs/figures/explanation.py
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from foundation.arrays import Array
from groundtruth import Run, simulate
from identification import Estimate
from needleforce import InsertionSession
from needleforce.plots import (
    STYLE,
    add_legend,
    draw_line,
    make_panels,
    mark_instants,
    palette,
    save_figure,
)
from residual import DEFAULT, PUBLISHED, MomentumObserver, VirtualForceSensor

FOLDER = Path(__file__).parents[1] / "images"
SEED = 0
DRAWN_STEP = 20
"""One sample of a force in so many is drawn: fifty a second."""

AVERAGED = 100
"""Samples over which an error is averaged before it is drawn: 0.1 s."""

HEIGHT_IN = 2.7
WIDTH_IN = 6.0

READING = {"color": palette.GREEN, "lw": 2.6, "alpha": 0.45}
OURS = {"color": palette.BLUE}
PUBLISHED_STYLE = {"color": palette.VERMILION, "ls": "--"}
PREDICTED = {"color": palette.ORANGE, "ls": "--"}
TRUE = {"color": palette.BLACK, "ls": ":", "lw": 1.5}
ALARM = {"color": palette.BLACK, "marker": "|", "ms": 13.0}


class ArmSample(NamedTuple):
    """Signals of one tick, as the sensor takes them.

    Attributes:
        q: Joint positions [rad], shape (n,).
        dq: Joint velocities [rad/s], shape (n,); None where the arm sends none.
        tau: Joint torques [Nm], shape (n,).
        dt_s: Time since the sample before.
    """

    q: Array
    dq: Array | None
    tau: Array
    dt_s: float


def samples_of(run: Run) -> Iterator[ArmSample]:
    """Yield the samples of a run."""
    signals = run.signals
    steps_s = np.diff(signals.t_s, prepend=signals.t_s[0] - 1e-3)
    for k, dt_s in enumerate(steps_s):
        dq = None if signals.dq_rad_s is None else signals.dq_rad_s[k]
        yield ArmSample(signals.q_rad[k], dq, signals.tau_Nm[k], float(dt_s))


def draw_force(axes: Axes, x: Array, y: Array, label: str, **style: Any) -> None:
    """Draw every `DRAWN_STEP`-th sample."""
    draw_line(axes, x[::DRAWN_STEP], y[::DRAWN_STEP], label=label, **style)


def averaged(values: Array) -> Array:
    """Return the means over `AVERAGED` samples; an incomplete rest is left out."""
    count = len(values) // AVERAGED
    return values[: count * AVERAGED].reshape(count, AVERAGED).mean(axis=1)


def draw_error(
    axes: Axes, x: Array, y: Array, label: str, std: Array | None = None, **style: Any
) -> None:
    """Draw means, with a band of two standard deviations if given."""
    mean_std = None if std is None else averaged(std)
    draw_line(axes, averaged(x), averaged(y), mean_std, label=label, **style)


def save(figure: Figure, x_label: str, name: str) -> None:
    """Write a figure with its legend."""
    figure.axes[-1].set_xlabel(x_label)
    add_legend(figure)
    save_figure(figure, FOLDER / name)


def residual_of(run: Run, gain_per_s: float) -> Array:
    """Return the residual at a gain [Nm], (n, 7), of a run with measured velocities."""
    observer = MomentumObserver(run.robot, gain_per_s=gain_per_s, alignment="hold")
    residual_Nm = []
    for q, dq, tau, dt_s in samples_of(run):
        assert dq is not None, "the plant ideal sends velocities"
        residual_Nm.append(observer.update(q, dq, tau, dt_s))
    return np.array(residual_Nm)


def draw_observer() -> None:
    """Draw the external torque of a joint around a rupture, at two gains."""
    run = simulate("gel-70-constant", plant="ideal", seed=SEED)
    rupture_s = run.truth.ruptures[0].onset_s
    time_s = run.signals.t_s - rupture_s
    truth_Nm = run.truth.external_torque_Nm
    joint = int(np.argmax(np.abs(truth_Nm).max(axis=0)))
    is_shown = (time_s > -0.1) & (time_s < 0.5)
    title = "Momentum residual around a rupture\ngel-70-constant, plant ideal"
    figure, (axes,) = make_panels(1, WIDTH_IN, HEIGHT_IN, title)
    for style, torque_Nm, label in (
        (READING, truth_Nm, "true external torque"),
        (OURS, residual_of(run, 70.0), "residual, K = 70/s"),
        (PUBLISHED_STYLE, residual_of(run, 5.0), "residual, K = 5/s"),
    ):
        shown_Nm = torque_Nm[is_shown, joint]
        draw_line(axes, time_s[is_shown], shown_Nm, label=label, **style)
    axes.set(ylabel=f"torque on joint {joint + 1} [Nm]", xlim=(-0.1, 0.5))
    save(figure, "time since the rupture [s]", "observer.svg")


def axial_of(run: Run, sensor: VirtualForceSensor) -> tuple[Array, Array]:
    """Return the axial force of a run and its standard deviation [N], (n,) each."""
    axial_N = np.full(len(run.signals.t_s), np.nan)
    std_N = np.full(len(run.signals.t_s), np.nan)
    is_tared = False
    for k, sample in enumerate(samples_of(run)):
        estimate = sensor.update(*sample)
        if not is_tared and run.signals.t_s[k] > run.tare_end_s:
            sensor.tare()
            is_tared = True
        if is_tared:
            axial_N[k] = estimate.axial
            std_N[k] = estimate.axial_std
    return axial_N, std_N


def draw_forces() -> None:
    """Draw the axial force on `fri`, ours and as published, and their errors."""
    run = simulate("gel-70-constant", plant="fri", seed=SEED)
    time_s = run.signals.t_s - run.tare_end_s
    true_N = run.truth.axial_N
    ours_N, std_N = axial_of(run, VirtualForceSensor(run.robot))
    published_N, _ = axial_of(run, VirtualForceSensor(run.robot, PUBLISHED))
    title = (
        "Axial force, and its error with two standard deviations\n"
        "gel-70-constant, plant fri; errors are means over 0.1 s"
    )
    figure, (force, error) = make_panels(2, WIDTH_IN, 1.5 * HEIGHT_IN, title)
    draw_force(force, time_s, published_N, "as published", **PUBLISHED_STYLE)
    draw_force(force, time_s, ours_N, "virtual sensor", **OURS)
    draw_force(force, time_s, true_N, "true", **TRUE)
    published_error_N = published_N - true_N
    draw_error(error, time_s, published_error_N, "as published", **PUBLISHED_STYLE)
    draw_error(error, time_s, ours_N - true_N, "virtual sensor", std_N, **OURS)
    force.set(ylabel=palette.FORCE, xlim=(0.0, time_s[-1]))
    error.set_ylabel(palette.FORCE_ERROR)
    save(figure, "time since the tare [s]", "virtual-sensor.svg")


def draw_tare() -> None:
    """Draw the error of the axial force with a constant bias and with the model."""
    run = simulate("stack-constant", plant="clean", seed=SEED)
    time_s = run.signals.t_s - run.tare_end_s
    constant = replace(DEFAULT, tare="constant", tare_window_s=0.5)
    constant_N, _ = axial_of(run, VirtualForceSensor(run.robot, constant))
    modelled_N, std_N = axial_of(run, VirtualForceSensor(run.robot))
    true_N = run.truth.axial_N
    title = (
        "Error of the axial force after a tare\n"
        "stack-constant, insertion and withdrawal, plant clean; means over 0.1 s"
    )
    figure, (axes,) = make_panels(1, WIDTH_IN, HEIGHT_IN, title)
    constant_error_N = constant_N - true_N
    draw_error(axes, time_s, constant_error_N, "constant bias", **PUBLISHED_STYLE)
    label = "modelled bias, two standard deviations"
    draw_error(axes, time_s, modelled_N - true_N, label, std_N, **OURS)
    axes.set_ylabel(palette.FORCE_ERROR)
    save(figure, "time since the tare [s]", "tare.svg")


def identified(run: Run) -> Iterator[Estimate]:
    """Yield what a session identifies at every sample of a run."""
    session = InsertionSession(run.robot)
    for t_s, sample in zip(run.signals.t_s, samples_of(run), strict=True):
        if not session.tared and t_s > run.tare_end_s:
            session.tare()
        yield session.update(*sample).identification


def draw_identification() -> None:
    """Draw axial force, tip force and friction over an insertion."""
    run = simulate("stack-constant", plant="clean", seed=SEED)
    truth = run.truth
    time_s = run.signals.t_s - run.tare_end_s
    end_s = time_s[int(np.argmax(truth.depth_m))]
    estimates = list(identified(run))
    tip_N = np.array([estimate.tip_force_N for estimate in estimates])
    shaft_N = np.array([estimate.shaft_friction_N for estimate in estimates])
    shaft_std_N = np.array([estimate.shaft_friction_std_N for estimate in estimates])
    alarms_s = [
        float(time_s[k])
        for k, estimate in enumerate(estimates)
        if estimate.rupture is not None
    ]
    title = (
        "Tip force and shaft friction while the needle advances\n"
        "stack-constant, virtual sensor, plant clean"
    )
    figure, (force, friction) = make_panels(2, WIDTH_IN, 1.5 * HEIGHT_IN, title)
    draw_force(force, time_s, truth.axial_N, "axial force", **READING)
    draw_force(force, time_s, tip_N, "tip force, estimated", **OURS)
    draw_force(force, time_s, truth.tip_N, "true", **TRUE)
    label = "shaft friction, estimated, two standard deviations"
    draw_error(friction, time_s, shaft_N, label, shaft_std_N, **PREDICTED)
    draw_force(friction, time_s, truth.friction_N, "true", **TRUE)
    for axes in (force, friction):
        mark_instants(axes, np.array(alarms_s), "alarms", **ALARM)
    force.set(ylabel="force [N]", xlim=(0.0, end_s))
    friction.set_ylabel("shaft friction [N]")
    save(figure, "time since the tare [s]", "identification.svg")


def draw_plants() -> None:
    """Draw the error of the published method on two plants."""
    title = (
        "Error of the published force estimate on two plants\n"
        "gel-70-constant, insertion and withdrawal; means over 0.1 s"
    )
    figure, (axes,) = make_panels(1, WIDTH_IN, HEIGHT_IN, title)
    for plant, style in (("clean", OURS), ("fri", PUBLISHED_STYLE)):
        run = simulate("gel-70-constant", plant=plant, seed=SEED)
        time_s = run.signals.t_s - run.tare_end_s
        axial_N, _ = axial_of(run, VirtualForceSensor(run.robot, PUBLISHED))
        draw_error(axes, time_s, axial_N - run.truth.axial_N, plant, **style)
    axes.set_ylabel(palette.FORCE_ERROR)
    save(figure, "time since the tare [s]", "plants.svg")


def main() -> None:
    """Draw all figures."""
    plt.style.use(STYLE)
    draw_observer()
    draw_forces()
    draw_tare()
    draw_identification()
    draw_plants()


if __name__ == "__main__":
    main()
