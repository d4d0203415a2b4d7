"""Products of small arrays, compiled."""

from foundation.arrays import Vector
from foundation.jit import compiled


@compiled
def dot(a: Vector, b: Vector) -> float:
    """Return the scalar product of two vectors of shape (n,).

    Of a few numbers a loop takes a tenth of the time that BLAS takes.
    """
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total
