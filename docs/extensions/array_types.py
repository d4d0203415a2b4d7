"""Array types under their short names, as our sources write them.

What numpy means by them is a union of many lines. Imported before our packages, so that
their annotations refer to these.
"""

from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing

Number = TypeVar("Number")
LONG: Any = numpy.typing.NDArray


class ArrayLike:
    """Whatever numpy makes an array of."""


class ArrayMeta(type):
    """Count numpy's arrays as instances: what reads snapshots asks for that."""

    def __instancecheck__(cls, value: Any) -> bool:
        """Return whether a value is an array."""
        return isinstance(value, np.ndarray)


class NDArray(Generic[Number], metaclass=ArrayMeta):
    """An array of numbers of one type."""


def shorten() -> None:
    """Replace numpy's types of arrays."""
    for short in (ArrayLike, NDArray):
        short.__module__ = "numpy.typing"
        setattr(numpy.typing, short.__name__, short)
