"""Which packets of a controller are new, and how much later they are."""

import pytest

from needleforce.devices.cycle_counter import CycleCounter

PERIOD_S = 1e-3
COUNTS = 1 << 16


def taken(counts, period_s=PERIOD_S):
    """The cycles of packets that come one a period; None for those refused."""
    counter = CycleCounter(COUNTS, 0.0)
    found = []
    for number, count in enumerate(counts, 1):
        now_s = number * period_s
        cycles = counter.cycles_to(count % COUNTS, period_s, now_s, now_s)
        if cycles is not None:
            counter.accept(count % COUNTS, now_s, now_s)
        found.append(cycles)
    return found


@pytest.mark.parametrize("period_s", [1e-3, 5e-3])
def test_a_foreign_packet_far_ahead_stops_none_of_the_real_ones(period_s):
    found = taken([*range(1000), 1199, *range(1000, 2000)], period_s)

    assert found[1000] is None
    assert found.count(None) == 1
    assert max(cycles for cycles in found if cycles is not None) <= 2


def test_a_foreign_packet_nearer_ahead_stops_the_real_ones_for_ten_cycles():
    # 80 ms ahead may be a delay of the network.
    found = taken([*range(1000), 1079, *range(1000, 2000)])

    assert found[1000] == 80
    assert found[1001:1010] == [None] * 9
    assert None not in found[1010:]


def test_a_controller_that_counts_anew_is_heard_after_ten_packets():
    for start in (0, 30_000, 60_000):
        found = taken([*range(40_000, 40_500), *range(start, start + 500)])

        assert found[500:509] == [None] * 9
        assert found[509] == 10
        assert None not in found[510:]


def test_repeated_and_late_packets_are_refused_for_ever():
    repeated = taken([number // 2 for number in range(2000)])

    assert repeated.count(None) == 1000

    late = taken([*range(100), *range(50, 59), *range(100, 200)])

    assert late[100:109] == [None] * 9
    assert late.count(None) == 9
    assert taken([7] * 500).count(None) == 499


def test_refused_packets_do_not_add_up_over_those_that_are_taken():
    found = taken([*range(100), *range(50, 59), *range(100, 200), 59, *range(200, 300)])

    assert found[209] is None
    assert found.count(None) == 10
