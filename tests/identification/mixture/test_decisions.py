"""Decisions: what counts as a rupture, and what a slower needle explains."""

import pytest

from foundation.records import read_column
from identification.estimate import NO_SAMPLE
from identification.mixture.decisions import (
    count_ruptures,
    may_be_braking,
)
from identification.mixture.evidence import weigh_evidence
from identification.mixture.force_model import LAYER, OFFSET, RELEASED
from identification.mixture.layer_report import report_rupture
from identification.mixture.learner import lag_of_speed
from identification.mixture.mixture import first_mixture
from identification.mixture.tissue_motion import TissueMotion
from tests.identification.mixture.mixtures import (
    BLOCK,
    branch,
    component,
    set_fields,
)


def braking_block(since_s, speed_mm_s, fall_N, **changes):
    """A block so long after a rupture at 10 s, 2.3 mm/s and 1 N."""
    block = BLOCK._replace(
        time_s=10.0 + since_s,
        depth_mm=50.0,
        speed_mm_s=speed_mm_s,
        force_N=1.0 - fall_N,
        usual_speed_mm_s=2.3,
        noise_std_N=0.004,
        unfiltered_depth_mm=50.0,
        speed_lag_s=0.1,
    )
    return block._replace(**changes)


@pytest.mark.parametrize(
    ("since_s", "speed_mm_s", "fall_N", "braking"),
    [
        (0.05, 2.3, 0.05, True),  # the speed may be late
        (0.05, 2.3, 0.20, False),  # too much for a speed that has not fallen
        (0.15, 2.3, 0.05, False),  # the needle has not slowed down
        (0.15, 1.9, 0.20, True),  # by 17 %: friction falls as far
        (0.15, 2.2, 0.20, False),  # by 4 %: it does not
        (0.15, 1.0, 0.40, True),  # by more than half, friction by less
        (0.15, 1.9, 0.40, False),
        (0.15, 2.3, 0.40, False),
    ],
)
def test_a_fall_that_braking_explains_is_no_rupture(
    since_s, speed_mm_s, fall_N, braking
):
    mixture = first_mixture()
    set_fields(
        mixture.history, rupture_s=10.0, rupture_speed_mm_s=2.3, rupture_force_N=1.0
    )
    block = braking_block(since_s, speed_mm_s, fall_N)
    known = TissueMotion()

    assert may_be_braking(mixture, 0, block, block.time_s, known) == braking

    if not braking:
        # The travel of a needle that has nearly stopped shows it, whatever a late speed
        # says.
        set_fields(mixture.history, rupture_mm=50.0 - 0.4 * since_s)
        assert may_be_braking(mixture, 0, block, block.time_s, known)


def test_a_coarse_encoder_makes_the_speed_later():
    assert lag_of_speed(0.0, 0.0) == 0.1
    assert lag_of_speed(1.0, 1e-9) == 0.3
    assert lag_of_speed(0.0041, 0.0558) == pytest.approx(0.22, abs=1e-3)


@pytest.mark.parametrize(
    ("fall_N", "lag_s", "waits"),
    [(0.2, 0.1, False), (0.2, 0.22, True), (0.25, 0.22, False)],
)
def test_a_slow_fall_waits_for_a_late_speed(fall_N, lag_s, waits):
    mixture = first_mixture()
    set_fields(
        mixture.history,
        rupture_s=10.0,
        rupture_mm=49.66,
        rupture_speed_mm_s=2.3,
        rupture_force_N=1.0,
    )
    block = braking_block(
        0.15, 2.3, fall_N, unfiltered_depth_mm=50.01, speed_lag_s=lag_s
    )

    assert may_be_braking(mixture, 0, block, 10.15, TissueMotion()) == waits


@pytest.mark.parametrize(
    ("since_s", "force_N", "min_force_N", "probability"),
    [
        (0.1, 1.1, 0.9, 1.0),
        (0.1, 1.1, 0.98, 0.0),
        (0.6, 0.8, 0.8, 1.0),
        (0.6, 1.1, 0.8, 0.0),
    ],
)
def test_a_rupture_counts_only_where_the_force_fell(
    since_s, force_N, min_force_N, probability
):
    """And, if it is reported late, where the force is still lower."""
    mixture = first_mixture()
    set_fields(mixture.assumptions, medium=LAYER, ruptures=1.0)
    mixture.means[0, RELEASED] = 0.3
    set_fields(
        mixture.history,
        rupture_s=BLOCK.time_s - since_s,
        rupture_force_N=1.0,
        min_force_N=min_force_N,
    )
    evidence = weigh_evidence(mixture, None, 0)
    count = count_ruptures(evidence, 0, BLOCK._replace(force_N=force_N))

    assert count.more == probability


def test_a_component_with_an_older_rupture_denies_the_alarm():
    mixture = branch(component(5, LAYER), 0.1, 0)
    alarm = report_rupture(
        weigh_evidence(mixture, None, 0),
        component=1,
        layer=1,
        probability=0.99,
        alarm=NO_SAMPLE._replace(time_s=3.0, clock_s=3.0, depth_m=0.012),
        contact_std_mm=0.1,
    )
    evidence = weigh_evidence(mixture, alarm, 1)

    assert read_column(mixture.assumptions, "ruptures")[0] == 1.0
    assert evidence.ruptures[0] == 0.0
    assert evidence.ruptures[1] == 1.0
    assert count_ruptures(evidence, 1, BLOCK).fewer > 0.9


@pytest.mark.parametrize(
    ("released_N", "noise_N", "probability"),
    [(0.11, 0.01, 1.0), (0.09, 0.01, 0.0), (0.17, 0.05, 1.0), (0.13, 0.05, 0.0)],
)
def test_a_rupture_releases_a_tenth_of_a_newton_and_more_than_noise(
    released_N, noise_N, probability
):
    mixture = first_mixture()
    set_fields(mixture.assumptions, medium=LAYER, ruptures=1.0)
    mixture.means[0, RELEASED] = released_N
    set_fields(
        mixture.history, rupture_s=BLOCK.time_s, rupture_force_N=1.0, min_force_N=0.9
    )
    block = BLOCK._replace(noise_std_N=noise_N)
    count = count_ruptures(weigh_evidence(mixture, None, 0), 0, block)

    assert count.more == probability


def test_no_more_than_the_whole_force_is_released():
    """A force of 0.08 N above that in free air is too little for a rupture."""
    mixture = first_mixture()
    set_fields(mixture.assumptions, medium=LAYER, ruptures=1.0)
    mixture.means[0, [RELEASED, OFFSET]] = 0.3, 0.2
    evidence = weigh_evidence(mixture, None, 0)
    for force_N, probability in ((0.28, 0.0), (0.38, 1.0)):
        set_fields(
            mixture.history,
            rupture_s=BLOCK.time_s,
            rupture_force_N=force_N,
            min_force_N=0.2,
        )
        assert count_ruptures(evidence, 0, BLOCK).more == probability
