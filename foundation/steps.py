"""Long work in short steps, so that it can be done beside the ticks of a loop.

A function in steps is a generator that yields after each short piece of work and
returns the result. Whoever runs it to the end at once and whoever runs a step per tick
do the same arithmetic in the same order: results are equal bit for bit.
"""

from collections.abc import Generator
from typing import TypeAlias, TypeVar

T = TypeVar("T")

Steps: TypeAlias = Generator[None, None, T]
"""Work that yields after every step and returns its result."""


def finish(steps: Steps[T]) -> T:
    """Do all steps that remain, and return the result."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value
