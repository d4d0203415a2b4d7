"""Draws the figures of the explanation pages from simulated insertions.

Run it in the project's folder; it takes two minutes:

    python docs/figures/explanation.py
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from groundtruth import Run, simulate
from identification import Estimate
from needleforce import InsertionSession
from needleforce.plots import (
    Chart,
    Curve,
    Instants,
    LineStyle,
    Panel,
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


def force_curve(x: Array, y: Array, style: LineStyle, label: str) -> Curve:
    """Return a curve of every `DRAWN_STEP`-th sample."""
    step = slice(None, None, DRAWN_STEP)
    return Curve(style=style, x=x[step], y=y[step], label=label)


def averaged(values: Array) -> Array:
    """Return the means over `AVERAGED` samples; an incomplete rest is left out."""
    count = len(values) // AVERAGED
    return values[: count * AVERAGED].reshape(count, AVERAGED).mean(axis=1)


def error_curve(
    x: Array, y: Array, style: LineStyle, label: str, std: Array | None = None
) -> Curve:
    """Return a curve of means, with a band of two standard deviations if given."""
    return Curve(
        style=style,
        x=averaged(x),
        y=averaged(y),
        label=label,
        std=None if std is None else averaged(std),
    )


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
    curves = [
        Curve(
            style=style,
            x=time_s[is_shown],
            y=torque_Nm[is_shown, joint],
            label=label,
        )
        for style, torque_Nm, label in (
            (palette.READING, truth_Nm, "true external torque"),
            (palette.OURS, residual_of(run, 70.0), "residual, K = 70/s"),
            (palette.PUBLISHED, residual_of(run, 5.0), "residual, K = 5/s"),
        )
    ]
    low = min(float(curve.y.min()) for curve in curves)
    high = max(float(curve.y.max()) for curve in curves)
    margin = 0.05 * (high - low)
    panel = Panel(
        y_label=f"torque on joint {joint + 1} [Nm]",
        curves=tuple(curves),
        limits=(low - margin, high + margin),
    )
    chart = Chart(
        title="Momentum residual around a rupture\ngel-70-constant, plant ideal",
        x_label="time since the rupture [s]",
        panels=(panel,),
        x_limits=(-0.1, 0.5),
        width_in=WIDTH_IN,
        height_in=HEIGHT_IN,
    )
    save_figure(chart, FOLDER / "observer.svg")


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
    force = Panel(
        y_label=palette.FORCE,
        curves=(
            force_curve(time_s, published_N, palette.PUBLISHED, "as published"),
            force_curve(time_s, ours_N, palette.OURS, "virtual sensor"),
            force_curve(time_s, true_N, palette.TRUE_PART, "true"),
        ),
        height=1.6,
    )
    error = Panel(
        y_label=palette.FORCE_ERROR,
        curves=(
            error_curve(
                time_s, published_N - true_N, palette.PUBLISHED, "as published"
            ),
            error_curve(
                time_s, ours_N - true_N, palette.OURS, "virtual sensor", std=std_N
            ),
        ),
    )
    chart = Chart(
        title="Axial force, and its error with two standard deviations\n"
        "gel-70-constant, plant fri; errors are means over 0.1 s",
        x_label="time since the tare [s]",
        panels=(force, error),
        width_in=WIDTH_IN,
        height_in=1.5 * HEIGHT_IN,
    )
    save_figure(chart.within(0.0, float(time_s[-1])), FOLDER / "virtual-sensor.svg")


def draw_tare() -> None:
    """Draw the error of the axial force with a constant bias and with the model."""
    run = simulate("stack-constant", plant="clean", seed=SEED)
    time_s = run.signals.t_s - run.tare_end_s
    constant = replace(DEFAULT, tare="constant", tare_window_s=0.5)
    constant_N, _ = axial_of(run, VirtualForceSensor(run.robot, constant))
    modelled_N, std_N = axial_of(run, VirtualForceSensor(run.robot))
    true_N = run.truth.axial_N
    panel = Panel(
        y_label=palette.FORCE_ERROR,
        curves=(
            error_curve(
                time_s, constant_N - true_N, palette.PUBLISHED, "constant bias"
            ),
            error_curve(
                time_s,
                modelled_N - true_N,
                palette.OURS,
                "modelled bias, two standard deviations",
                std=std_N,
            ),
        ),
    )
    chart = Chart(
        title="Error of the axial force after a tare\n"
        "stack-constant, insertion and withdrawal, plant clean; means over 0.1 s",
        x_label="time since the tare [s]",
        panels=(panel,),
        width_in=WIDTH_IN,
        height_in=HEIGHT_IN,
    )
    save_figure(chart, FOLDER / "tare.svg")


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
    force = Panel(
        y_label="force [N]",
        curves=(
            force_curve(time_s, truth.axial_N, palette.READING, "axial force"),
            force_curve(time_s, tip_N, palette.OURS, "tip force, estimated"),
            force_curve(time_s, truth.tip_N, palette.TRUE_PART, "true"),
        ),
    )
    friction = Panel(
        y_label="shaft friction [N]",
        curves=(
            error_curve(
                time_s,
                shaft_N,
                palette.PREDICTED,
                "shaft friction, estimated, two standard deviations",
                std=shaft_std_N,
            ),
            force_curve(time_s, truth.friction_N, palette.TRUE_PART, "true"),
        ),
    )
    chart = Chart(
        title="Tip force and shaft friction while the needle advances\n"
        "stack-constant, virtual sensor, plant clean",
        x_label="time since the tare [s]",
        panels=(force, friction),
        instants=(Instants("alarms", palette.RUPTURE, tuple(alarms_s)),),
        width_in=WIDTH_IN,
        height_in=1.5 * HEIGHT_IN,
    )
    save_figure(chart.within(0.0, float(end_s)), FOLDER / "identification.svg")


def draw_plants() -> None:
    """Draw the error of the published method on two plants."""
    curves = []
    for plant, style in (("clean", palette.OURS), ("fri", palette.PUBLISHED)):
        run = simulate("gel-70-constant", plant=plant, seed=SEED)
        time_s = run.signals.t_s - run.tare_end_s
        axial_N, _ = axial_of(run, VirtualForceSensor(run.robot, PUBLISHED))
        curves.append(error_curve(time_s, axial_N - run.truth.axial_N, style, plant))
    chart = Chart(
        title="Error of the published force estimate on two plants\n"
        "gel-70-constant, insertion and withdrawal; means over 0.1 s",
        x_label="time since the tare [s]",
        panels=(Panel(y_label=palette.FORCE_ERROR, curves=tuple(curves)),),
        width_in=WIDTH_IN,
        height_in=HEIGHT_IN,
    )
    save_figure(chart, FOLDER / "plants.svg")


def main() -> None:
    """Draw all figures."""
    draw_observer()
    draw_forces()
    draw_tare()
    draw_identification()
    draw_plants()


if __name__ == "__main__":
    main()
