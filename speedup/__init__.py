"""Compiles the arithmetic of a tick where numba is installed (the extra ``fast``).

One function, one source: without numba the plain Python runs, slower, with the same numbers to
rounding. `speedup.compiled` says what a function must be like.
"""

from speedup.compiled import (
    COMPILER,
    Matrix,
    StridedVector,
    Vector,
    WrittenMatrix,
    WrittenVector,
    compiled,
)

__all__ = [
    "COMPILER",
    "Matrix",
    "StridedVector",
    "Vector",
    "WrittenMatrix",
    "WrittenVector",
    "compiled",
]
