"""States come back bit for bit; a file that holds none is refused."""

import hashlib
import os
import pickle

import numpy as np
import pytest

from foundation.state import STATE_VERSION, StateError, read_sealed_state, seal_state
from residual.momentum_observer import MomentumState
from tests.insertion_run import same

KINDS = {"observer": MomentumState}


def state_of(order="C"):
    rows = np.array(np.random.default_rng(0).normal(size=(9, 7)), order=order)
    return MomentumState(rows, np.zeros(0), started=True)


SEALED = seal_state(state_of(), "observer")


@pytest.mark.parametrize("order", ["C", "F"])
def test_a_state_comes_back_with_bits_and_order(order, tmp_path):
    path = tmp_path / "a.state"
    path.write_bytes(seal_state(state_of(order), "observer"))
    found = read_sealed_state(path, KINDS)

    assert same(found, state_of(order))
    assert found.rows.flags.f_contiguous == (order == "F")


class Harm:
    """What a pickle could do."""

    def __reduce__(self):
        return os.system, ("true",)


@pytest.mark.parametrize("value", [object(), Harm(), os.system, {1j}])
def test_what_is_no_state_is_neither_written_nor_read(value, tmp_path):
    with pytest.raises(StateError):
        seal_state(MomentumState(value, np.zeros(0)), "observer")

    path = tmp_path / "a.state"
    data = pickle.dumps(value)
    digest = hashlib.sha256(data).hexdigest().encode()
    path.write_bytes(b" ".join((*SEALED.split(b" ")[:3], digest)) + b"\n" + data)
    with pytest.raises(StateError):
        read_sealed_state(path, KINDS)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"", "no state"),
        (SEALED[:-5], "cut short"),
        (SEALED.replace(b"-state", b"-table", 1), "no state"),
        (SEALED.replace(b"%d" % STATE_VERSION, b"2", 1), "version 2"),
        (SEALED.replace(b"observer", b"arm", 1), "arm"),
        (SEALED[:-9] + bytes([SEALED[-9] ^ 4]) + SEALED[-8:], "damaged"),
        (seal_state(np.zeros(2), "observer"), "ndarray"),
        (SEALED + bytes(65 << 20), "no state"),
    ],
)
def test_a_file_that_holds_no_such_state_is_refused(content, word, tmp_path):
    path = tmp_path / "a.state"
    path.write_bytes(content)

    with pytest.raises(StateError, match=word):
        read_sealed_state(path, KINDS)
