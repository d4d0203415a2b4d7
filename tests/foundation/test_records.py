"""States that compiled functions read and write by the names of their fields."""

from dataclasses import dataclass

import pytest

from foundation.jit import compiled
from foundation.records import as_record, from_record, read_field


@dataclass(slots=True)
class Axis:
    """One of the states inside another."""

    place_m: float = 0.0
    steps: int = 0


@dataclass(slots=True)
class Stage:
    """A state with numbers, a truth value and other states."""

    speed_m_s: float = 0.0
    is_on: bool = False
    axes: tuple[Axis, Axis] = (Axis(), Axis())


@compiled
def move(axis: Axis, by_m: float) -> None:
    axis.place_m += by_m
    axis.steps += 1


@compiled
def move_second(stages: list[Stage], by_m: float) -> float:
    stage = stages[0]
    stage.is_on = True
    move(stage.axes[1], by_m)
    return stage.speed_m_s


def test_compiled_code_writes_into_a_record_only():
    state = Stage(speed_m_s=0.5)
    record = as_record(state)

    assert move_second(record, 2.0) == 0.5
    assert move_second(record, 1.0) == 0.5

    moved = from_record(Stage, record)

    assert moved == Stage(0.5, True, (Axis(), Axis(3.0, 2)))
    assert state == Stage(speed_m_s=0.5)
    assert read_field(record, "is_on")


@pytest.mark.parametrize("state", [Stage(), Stage(0.1, True, (Axis(0.3, 7), Axis()))])
def test_a_state_comes_back_from_its_record(state):
    restored = from_record(Stage, as_record(state))

    assert restored == state
    assert type(restored.is_on) is bool
    assert type(restored.axes[0].steps) is int
