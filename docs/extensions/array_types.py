"""Array types under their short names, as our sources write them.

What numpy means by them is a union of many lines. Imported before our packages, so that
their annotations refer to these.
"""

from typing import Annotated, Any, Generic, TypeVar, get_args, get_origin

import numpy as np
import numpy.typing

from foundation import compile_cache

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
    _keep_compiled()


def _keep_compiled() -> None:
    """Let the cache of compiled code see numpy's own types: it has that code already.

    Compiling all again, in this process, takes a minute.
    """
    describe, find_types = compile_cache._describe_value, compile_cache._find_types
    short_text, long_text = repr(NDArray[np.float64]), repr(LONG[np.float64])

    def lengthen(value: Any) -> Any:
        if get_origin(value) is Annotated:
            return Annotated[(lengthen(value.__origin__), *value.__metadata__)]
        return LONG[get_args(value)] if get_origin(value) is NDArray else value

    def describe_long(value: Any) -> str:
        return describe(lengthen(value)).replace(short_text, long_text)

    compile_cache._describe_value = describe_long
    compile_cache._find_types = lambda value: find_types(lengthen(value))
