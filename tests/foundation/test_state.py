"""States are checked by their types, and come back bit for bit."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import msgspec
import numpy as np
import pytest

from foundation.arrays import Array, Vector
from foundation.state import (
    Envelope,
    StateError,
    check_state,
    decode_state,
    encode_state,
    read_sealed_state,
    seal_state,
)


class Mixture(NamedTuple):
    """A record with an array whose rows are free."""

    weights: Array
    count: int

    GROWING = ("weights",)

    def find_damage(self):
        return "" if self.count == len(self.weights) else "the count is wrong"


class Filter(NamedTuple):
    """A record with a limit that may be infinite, and another record."""

    gains: Vector
    limit_s: float
    mixture: Mixture
    name: str | None = None

    MAY_BE_INFINITE = ("limit_s",)


@dataclass
class Line:
    """One of two methods."""

    slope: float


@dataclass
class Parabola:
    """The other."""

    slope: float
    curvature: float


class Fit(NamedTuple):
    """A record whose method the file has to tell."""

    method: Line | Parabola
    before: tuple[Line | Parabola, ...] = ()


def sound_state(rows=2):
    mixture = Mixture(np.arange(3.0 * rows).reshape(rows, 3), rows)
    return Filter(np.array([0.1, 1.0 / 3.0]), math.inf, mixture)


def test_a_sound_state_of_more_rows_passes():
    assert check_state(sound_state(rows=5), sound_state(rows=2)) is None


@pytest.mark.parametrize(
    ("damaged", "message"),
    [
        (sound_state()._replace(limit_s="1"), r"state.limit_s is a str"),
        (sound_state()._replace(limit_s=math.nan), r"state.limit_s cannot be nan"),
        (
            sound_state()._replace(gains=np.array([1.0, math.inf])),
            r"state.gains cannot",
        ),
        (sound_state()._replace(gains=np.ones(3)), r"gains has shape \(3,\)"),
        (sound_state()._replace(gains=np.ones(2, int)), r"gains is an array of int64"),
        (sound_state()._replace(mixture=None), r"state.mixture is a NoneType"),
        (
            sound_state()._replace(mixture=Mixture(np.ones((2, 3)), 1)),
            r"state.mixture: the count is wrong",
        ),
        (
            sound_state()._replace(mixture=Mixture(np.ones((2, 4)), 2)),
            r"weights has shape \(2, 4\), expected \(2, 3\)",
        ),
        (sound_state().mixture, r"state is a Mixture, expected a Filter"),
    ],
)
def test_a_damaged_state_is_refused_by_place(damaged, message):
    with pytest.raises(StateError, match=message):
        check_state(damaged, sound_state())


def test_one_of_several_records_comes_back_by_its_fields():
    fit = Fit(Parabola(1.0, 2.0), (Line(3.0), Parabola(4.0, 5.0)))

    assert decode_state(encode_state(fit), Fit) == fit

    other = msgspec.msgpack.encode([{"slope": 1.0, "kind": "os.system"}, []])
    with pytest.raises(StateError):
        decode_state(other, Fit)


@pytest.mark.parametrize("order", ["C", "F"])
def test_arrays_come_back_with_bits_and_order(order):
    weights = np.array(np.random.default_rng(0).normal(size=(4, 3)), order=order)
    state = sound_state()._replace(mixture=Mixture(weights, 4))
    decoded = decode_state(encode_state(state), Filter)

    assert decoded.mixture.weights.tobytes("A") == weights.tobytes("A")
    assert decoded.mixture.weights.flags.f_contiguous == (order == "F")
    assert decoded.limit_s == math.inf


@pytest.mark.parametrize("value", [object(), np.ones(2, dtype=np.float32), 1j])
def test_what_is_no_state_is_not_written(value):
    with pytest.raises((StateError, TypeError)):
        encode_state(Mixture(value, 1))


def test_a_file_gives_the_state_back(tmp_path):
    path = tmp_path / "a.state"
    path.write_bytes(seal_state(sound_state(), "filter"))
    state = read_sealed_state(path, {"filter": Filter})

    assert isinstance(state, Filter)
    assert state.gains.tolist() == [0.1, 1.0 / 3.0]


def sealed(**changes):
    content = seal_state(sound_state(), "filter")
    envelope = msgspec.msgpack.decode(content, type=Envelope)
    for name, value in changes.items():
        setattr(envelope, name, value)
    return msgspec.msgpack.encode(envelope)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "holds no state, or is cut short"),
        (seal_state(sound_state(), "filter")[:-5], "holds no state, or is cut short"),
        (sealed(format="other"), "its format is 'other'"),
        (sealed(version=2), "has version 2, this package reads version 11"),
        (sealed(data=b"\x90"), "is damaged: its bytes do not have its sha256"),
        (sealed(kind="arm"), "holds the state of a 'arm', expected one of filter"),
        (seal_state(sound_state().mixture, "filter"), "is damaged"),
    ],
)
def test_a_file_that_holds_no_such_state_is_refused(tmp_path, content, message):
    path = tmp_path / "a.state"
    path.write_bytes(content)

    with pytest.raises(StateError, match=message):
        read_sealed_state(path, {"filter": Filter})
