"""Insertions made for tests: two layers of a known law, and those of the simulator."""

from typing import NamedTuple

import numpy as np
import pytest

from identification import Identifier

SPEED_M_S = 4e-3

THICKNESS_M = (15e-3, 20e-3)
"""Of the two layers."""

STIFFNESS_N_PER_M = (20.0, 35.0)
"""Growth of the tip force in each."""

FRICTION_N_PER_M = (25.0, 40.0)
"""Shaft friction of each at `SPEED_M_S`, per length."""

RELEASE_M = 0.3e-3
"""Travel of a release."""

ABOVE_M = 4e-3
"""The needle begins so far above the tissue."""


class Row(NamedTuple):
    """A sample as `Identifier.update` takes it."""

    depth_m: float
    speed_m_s: float | None
    force_N: float
    dt_s: float


def true_force(depth_m, sliding=1.0):
    """Tip force and friction [N] at a depth; `sliding` is 1 inwards at `SPEED_M_S`."""
    tip_N = 0.0
    friction_N = 0.0
    start_m = 0.0
    layers = zip(THICKNESS_M, STIFFNESS_N_PER_M, FRICTION_N_PER_M, strict=True)
    for thickness_m, stiffness_N_per_m, friction_N_per_m in layers:
        inside_m = depth_m - start_m
        if 0.0 < inside_m <= thickness_m:
            tip_N += stiffness_N_per_m * inside_m
        elif thickness_m < inside_m < thickness_m + RELEASE_M:
            remaining = 1.0 - (inside_m - thickness_m) / RELEASE_M
            tip_N += stiffness_N_per_m * thickness_m * remaining**2
        embedded_m = min(max(inside_m, 0.0), thickness_m)
        friction_N += sliding * friction_N_per_m * embedded_m
        start_m += thickness_m
    return tip_N, friction_N


def insertion(moves, seed=0, noise_N=5e-3, motion_m=None, jitter_m=0.0, sway=0.0):
    """Samples of moves, each a travel [m] and seconds, from above the tissue.

    The tissue moves by ``motion_m(t)``, the depth is seen with a jitter, and the speed
    sways by a fraction of itself.
    """
    rng = np.random.default_rng(seed)
    depth_m = -ABOVE_M
    deepest_m = -ABOVE_M
    sliding = 1.0
    t_s = 0.0
    rows = []
    for travel_m, seconds in moves:
        n = round(1e3 * seconds)
        ramp = np.minimum(np.minimum(np.arange(n) + 1.0, n - np.arange(n)) / 100.0, 1.0)
        ramp *= 1.0 + sway * np.sin(2.0 * np.pi * 0.5e-3 * np.arange(n))
        for step_m in (travel_m * ramp / ramp.sum()).tolist():
            depth_m = depth_m + step_m
            t_s = t_s + 1e-3
            in_tissue_m = depth_m - (motion_m(t_s) if motion_m else 0.0)
            limit = np.sign(step_m)
            sliding = limit + (sliding - limit) * np.exp(-abs(step_m) / 0.3e-3)
            # Half of the friction is Coulomb's, half viscous.
            viscous = step_m / (1e-3 * SPEED_M_S)
            tip_N, friction_N = true_force(in_tissue_m, 0.5 * sliding + 0.5 * viscous)
            tip_N *= in_tissue_m >= deepest_m - 0.3e-3
            deepest_m = max(deepest_m, in_tissue_m)
            seen_m = depth_m + jitter_m * rng.standard_normal()
            force_N = tip_N + friction_N + noise_N * rng.standard_normal()
            rows.append(Row(float(seen_m), 1e3 * step_m, float(force_N), 1e-3))
    return rows


def straight(seed=0, **changes):
    """Samples of an insertion through both layers at `SPEED_M_S`."""
    return insertion([(46e-3, 46e-3 / SPEED_M_S)], seed, **changes)


def rows_of(depth_m, speed_m_s, force_N, dt_s):
    """Samples of columns, or of numbers that hold for all; no speed is None."""
    speeds = np.nan if speed_m_s is None else speed_m_s
    columns = np.broadcast_arrays(depth_m, speeds, force_N, dt_s)
    rows = [Row(*values) for values in zip(*(c.tolist() for c in columns), strict=True)]
    return rows if speed_m_s is not None else [r._replace(speed_m_s=None) for r in rows]


def noisy(force_N, std_N, seed):
    """A force with white noise, shape (n,)."""
    return force_N + std_N * np.random.default_rng(seed).standard_normal(len(force_N))


def run(rows, identifier=None):
    """The identifier after the rows, and its estimates."""
    identifier = identifier or Identifier()
    return identifier, [identifier.update(*row) for row in rows]


def samples_of(simulated_run):
    """Which samples of the simulator's needle follow the tare, and these samples."""
    t_s = simulated_run.t_s
    end_s = simulated_run.scenario.motion.withdrawal_start_s
    rows = (t_s > simulated_run.tare_end_s) & (t_s < end_s)
    motion = (simulated_run.depth_m, simulated_run.speed_m_s, simulated_run.force_N)
    columns = np.broadcast_arrays(*motion, t_s[1] - t_s[0], t_s)
    return rows, np.transpose(columns)[rows].tolist()


def follow(simulated_run, identifier=None):
    """The identifier after a run of the simulator's needle, its estimates, and which
    samples of the run these are."""
    rows, samples = samples_of(simulated_run)
    return *run(samples, identifier), rows


def values_of(estimates, name):
    """A field of all estimates where it is not None."""
    values = (getattr(estimate, name) for estimate in estimates)
    return [value for value in values if value is not None]


def kept_ruptures(estimates):
    """Ruptures that were reported and not retracted."""
    retracted_s = {rupture.alarm_s for rupture in values_of(estimates, "retracted")}
    ruptures = values_of(estimates, "rupture")
    return [rupture for rupture in ruptures if rupture.alarm_s not in retracted_s]


def assert_both_found(identifier, estimates, *, within=0.2):
    """Both ruptures are reported, and the friction of both layers."""
    ends_m = np.cumsum(THICKNESS_M)
    found_m = [rupture.depth_m for rupture in kept_ruptures(estimates)]
    assert found_m == pytest.approx(ends_m, abs=0.3e-3)
    friction_N = np.multiply(FRICTION_N_PER_M, THICKNESS_M)
    errors_N = np.abs([layer.friction_N for layer in identifier.layers] - friction_N)
    stds_N = np.array([layer.friction_std_N for layer in identifier.layers])
    assert (errors_N < within * friction_N).all()
    assert (errors_N < 3.0 * stds_N + 0.03 * friction_N).all()
