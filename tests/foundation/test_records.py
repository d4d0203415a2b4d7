"""States that compiled functions read and write by the names of their fields."""

from dataclasses import dataclass

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

    unmoved = from_record(Stage, record)

    assert [move_second(record, by_m) for by_m in (2.0, 1.0)] == [0.5, 0.5]

    moved = from_record(Stage, record)

    assert (unmoved, moved) == (state, Stage(0.5, True, (Axis(), Axis(3.0, 2))))
    # Of Python's types, too.
    assert repr(moved) == repr(Stage(0.5, True, (Axis(), Axis(3.0, 2))))
    assert state == Stage(speed_m_s=0.5)
    assert read_field(record, "is_on")
