"""The rupture state machine goes only where the authors' does."""

from itertools import product

from identification.estimate import RuptureState as S
from identification.estimate import next_rupture_state


def test_the_published_path_goes_through_all_states():
    assert next_rupture_state(S.NO_RUPTURE, is_expected=True) is S.EXPECTED
    assert next_rupture_state(S.EXPECTED, is_alarm=True, is_expected=True) is S.DETECTED
    assert next_rupture_state(S.DETECTED) is S.FORCE_DROP_MEASURING
    assert next_rupture_state(S.FORCE_DROP_MEASURING) is S.FORCE_DROP_MEASURING
    assert next_rupture_state(S.FORCE_DROP_MEASURING, is_measured=True) is S.COMPENSATED
    assert next_rupture_state(S.COMPENSATED) is S.NO_RUPTURE


def test_alarm_alone_is_enough_and_expectation_may_pass():
    assert next_rupture_state(S.NO_RUPTURE, is_alarm=True) is S.DETECTED
    assert next_rupture_state(S.EXPECTED) is S.NO_RUPTURE


def test_no_alarm_interrupts_a_measurement():
    for alarm, expected in product((False, True), repeat=2):
        flags = {"is_alarm": alarm, "is_expected": expected}
        assert next_rupture_state(S.FORCE_DROP_MEASURING, **flags) is S.FORCE_DROP_MEASURING
        assert next_rupture_state(S.COMPENSATED, is_settled=False, **flags) is S.COMPENSATED
