"""Linear algebra and sorting of small arrays, written as loops and compiled.

Of a few numbers a loop takes a tenth of the time that BLAS takes, and it compiles in a
tenth of the time that an expression of arrays takes. Inverses and eigenvalues are
numpy's, which the compiler knows.
"""

import math

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array, Matrix, Vector, WrittenMatrix, WrittenVector
from foundation.jit import compiled, compiled_inside

MAX_SWEEPS = 30
"""Sweeps of `make_rows_orthogonal`, at most: six or seven are enough for 20 rows."""

ROUNDING = 2.0**-52
"""Relative rounding error of a float."""


@compiled
def dot(a: Vector, b: Vector) -> float:
    """Return the scalar product of two vectors of shape (n,)."""
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


@compiled_inside
def index_of_largest(values: Vector) -> int:
    """Return the index of the largest of n values, the first of equal ones."""
    largest = 0
    for k in range(len(values)):
        if values[k] > values[largest]:
            largest = k
    return largest


@compiled_inside
def multiply_vector(matrix: Matrix, vector: Vector) -> Array:
    """Return ``matrix @ vector``, for shapes (m, n) and (n,)."""
    rows, columns = matrix.shape
    product = np.zeros(rows)
    for i in range(rows):
        for k in range(columns):
            product[i] += matrix[i, k] * vector[k]
    return product


@compiled_inside
def multiply(a: Matrix, b: Matrix) -> Array:
    """Return ``a @ b``, for shapes (m, k) and (k, n)."""
    rows, inner = a.shape
    columns = b.shape[1]
    product = np.zeros((rows, columns))
    for i in range(rows):
        for k in range(inner):
            factor = a[i, k]
            for j in range(columns):
                product[i, j] += factor * b[k, j]
    return product


@compiled_inside
def multiply_transposed(a: Matrix, b: Matrix) -> Array:
    """Return ``a @ b.T``, for shapes (m, k) and (n, k)."""
    rows, inner = a.shape
    columns = len(b)
    product = np.zeros((rows, columns))
    for i in range(rows):
        for j in range(columns):
            total = 0.0
            for k in range(inner):
                total += a[i, k] * b[j, k]
            product[i, j] = total
    return product


@compiled_inside
def make_rows_orthogonal(rows: WrittenMatrix, companions: WrittenMatrix) -> None:
    """Rotate rows, shape (m, n), until they are orthogonal to each other.

    One-sided Jacobi rotations (Golub and Van Loan, Matrix Computations, 8.6.3): the
    rows A become S V^T of A = U S V^T, in any order, each accurate relative to its own
    length.

    Args:
        rows: A, overwritten by S V^T.
        companions: C with the same number of rows, overwritten by U^T C.
    """
    for _ in range(MAX_SWEEPS):
        is_rotated = False
        for p in range(len(rows)):
            for q in range(p + 1, len(rows)):
                product = dot(rows[p], rows[q])
                p_squared = dot(rows[p], rows[p])
                q_squared = dot(rows[q], rows[q])
                negligible = ROUNDING * math.sqrt(p_squared * q_squared)
                # Written so that a NaN ends it.
                if abs(product) > negligible:
                    is_rotated = True
                    ratio = (q_squared - p_squared) / (2.0 * product)
                    tangent = math.copysign(1.0, ratio) / (
                        abs(ratio) + math.hypot(1.0, ratio)
                    )
                    rotate_rows(rows, p, q, tangent)
                    rotate_rows(companions, p, q, tangent)
        if not is_rotated:
            break


@compiled_inside
def rotate_rows(rows: WrittenMatrix, p: int, q: int, tangent: float) -> None:
    """Rotate two rows into each other by an angle with that tangent."""
    cosine = 1.0 / math.hypot(1.0, tangent)
    sine = tangent * cosine
    for k in range(rows.shape[1]):
        a = rows[p, k]
        b = rows[q, k]
        rows[p, k] = cosine * a - sine * b
        rows[q, k] = sine * a + cosine * b


@compiled_inside
def remove_parts(vector: WrittenVector, basis: Matrix, size: int) -> None:
    """Subtract the parts along the first so many rows of an orthonormal basis.

    Twice, since the first time leaves rounding relative to what was subtracted.
    """
    for i in range(2 * size):
        direction = basis[i % size]
        part = dot(vector, direction)
        for k in range(vector.size):
            vector[k] -= part * direction[k]


@compiled_inside
def find_complement(basis: Matrix, size: int) -> Array:
    """Return orthonormal directions across the first rows of an orthonormal basis.

    Args:
        basis: Rows of shape (n,).
        size: Number of them that count, r.

    Returns:
        The directions in rows, shape (n - r, n).
    """
    dimensions = basis.shape[1]
    all_directions = np.zeros((dimensions, dimensions))
    all_directions[:size] = basis[:size]
    uncovered = np.ones(dimensions)  # squared part of each axis that is left
    for i in range(size):
        for k in range(dimensions):
            uncovered[k] -= basis[i, k] ** 2
    for i in range(size, dimensions):
        direction = all_directions[i]
        direction[index_of_largest(uncovered)] = 1.0
        remove_parts(direction, all_directions, i)
        length = math.sqrt(dot(direction, direction))
        for k in range(dimensions):
            direction[k] /= length
            uncovered[k] -= direction[k] ** 2
    return all_directions[size:]


@compiled_inside
def solve_least_squares(matrix: Matrix, values: Vector, tolerance: float) -> Array:
    """Return the shortest x that minimises ``|matrix @ x - values|``, shape (n,).

    Singular values of the matrix, shape (m, n), below the largest times the tolerance
    count as zero.
    """
    equations, unknowns = matrix.shape
    solution = np.zeros(unknowns)
    is_wide = equations < unknowns
    if is_wide:
        rows = matrix.copy()
        companions = values.copy().reshape(equations, 1)
    else:
        rows = np.ascontiguousarray(matrix.T)
        companions = np.eye(unknowns)
    make_rows_orthogonal(rows, companions)
    squares = np.zeros(len(rows))
    largest = 0.0
    for i in range(len(rows)):
        squares[i] = dot(rows[i], rows[i])
        largest = max(largest, squares[i])
    for i in range(len(rows)):
        if squares[i] > tolerance**2 * largest:
            direction = rows[i] if is_wide else companions[i]
            part = companions[i, 0] if is_wide else dot(rows[i], values)
            for k in range(unknowns):
                solution[k] += part / squares[i] * direction[k]
    return solution


@compiled_inside
def sort_descending(values: Vector) -> NDArray[np.int64]:
    """Return the indices of values, the largest first, equal ones in their order.

    Insertion sort: the values of a mixture are nearly sorted already.
    """
    size = len(values)
    order = np.zeros(size, dtype=np.int64)
    for k in range(size):
        place = k
        while place > 0 and values[order[place - 1]] < values[k]:
            order[place] = order[place - 1]
            place -= 1
        order[place] = k
    return order
