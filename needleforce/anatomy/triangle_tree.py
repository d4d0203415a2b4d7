"""The nearest place on triangles, by a binary tree of boxes around them.

The tree is complete: node k has the children 2 k + 1 and 2 k + 2, and every leaf the
same number of triangles. Each level halves the triangles of a node along the axis on
which their middles spread most.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array, Matrix, Vector, WrittenMatrix, WrittenVector
from foundation.jit import compiled, compiled_inside

LEAF_TRIANGLES = 4
"""Triangles of a leaf: fewer cost more boxes, more cost more triangles."""

MAX_DEPTH = 64
"""Of the tree, and of what waits to be looked at: 2^64 triangles."""


class NearestPlaces(NamedTuple):
    """The nearest places on triangles.

    Attributes:
        places: One for each point, (n, 3).
        triangles: Number of the triangle of each, (n,).
    """

    places: Array
    triangles: NDArray[np.intp]


class TriangleTree:
    """Triangles, ready to find the nearest of them.

    Args:
        corners: Of each triangle, which has an area, (m, 3, 3).
    """

    def __init__(self, corners: Array) -> None:
        levels = max(int(np.ceil(np.log2(len(corners) / LEAF_TRIANGLES))), 0)
        count = LEAF_TRIANGLES << levels
        order = np.minimum(np.arange(count), len(corners) - 1)  # the last fills up
        middles = corners.mean(axis=1)
        lows = corners.min(axis=1)
        highs = corners.max(axis=1)
        boxes: list[Array] = []
        for level in range(levels + 1):
            nodes = order.reshape(1 << level, -1)
            boxes.append(np.hstack([lows[nodes].min(axis=1), highs[nodes].max(axis=1)]))
            spreads = np.ptp(middles[nodes], axis=1)
            along = np.take_along_axis(
                middles[nodes], spreads.argmax(axis=1)[:, None, None], axis=2
            )
            sorted_places = np.argsort(along[:, :, 0], axis=1)
            if level < levels:
                order = np.take_along_axis(nodes, sorted_places, axis=1).ravel()
        self._boxes = np.ascontiguousarray(np.concatenate(boxes))
        self._order = order
        self._corners = np.ascontiguousarray(corners[order].reshape(count, 9))
        self._middles = np.ascontiguousarray(middles[order])
        edges = corners[order, 1:] - corners[order, :1]
        self._areas = 0.5 * np.cross(edges[:, 0], edges[:, 1])
        repeated = np.flatnonzero(order == len(corners) - 1)[1:]
        self._areas[repeated] = 0.0

    def nearest(self, points: Array) -> NearestPlaces:
        """Return the nearest places on the triangles to points (n, 3)."""
        places = np.full((len(points), 3), np.nan)
        numbers = np.zeros(len(points))
        find_nearest(
            np.ascontiguousarray(points), self._boxes, self._corners, places, numbers
        )
        return NearestPlaces(places, self._order[numbers.astype(np.intp)])

    def mean_normals(self, positions: Array, normals: Array, reach: float) -> Array:
        """Return means of the normals around positions on the triangles, (n, 3).

        Each triangle counts by its area if its middle lies within reach and it looks to
        the same side; where none does, the normal itself is returned.

        Args:
            positions: Shape (n, 3).
            normals: There, (n, 3).
            reach: Radius around each position.
        """
        means = np.array(normals, order="C")
        add_normals(
            np.ascontiguousarray(positions),
            reach,
            self._boxes,
            self._middles,
            self._areas,
            means,
        )
        return means


@compiled
def find_nearest(
    points: Matrix,
    boxes: Matrix,
    corners: Matrix,
    places: WrittenMatrix,
    numbers: WrittenVector,
) -> float:
    """Find the nearest place on triangles to each of some points.

    Args:
        points: Shape (n, 3).
        boxes: Least and largest coordinates of the nodes, (2 leaves - 1, 6).
        corners: Of the triangles, in the order of the leaves, (m, 9).
        places: The nearest places, written, (n, 3).
        numbers: Numbers of their triangles in that order, written, (n,).

    Returns:
        The largest distance.
    """
    first_leaf = len(boxes) // 2
    leaf_triangles = len(corners) // (first_leaf + 1)
    waiting = np.empty(MAX_DEPTH)
    place = np.empty(3)
    largest = 0.0
    for row in range(len(points)):
        best = np.inf
        waiting[0] = 0.0
        count = 1
        while count > 0:
            count -= 1
            node = int(waiting[count])
            if _square_to_box(points[row], boxes[node]) >= best:
                continue
            if node >= first_leaf:
                start = (node - first_leaf) * leaf_triangles
                for number in range(start, start + leaf_triangles):
                    square = _nearest_on(points[row], corners[number], place)
                    if square < best:
                        best = square
                        numbers[row] = number
                        for axis in range(3):
                            places[row, axis] = place[axis]
                continue
            left = _square_to_box(points[row], boxes[2 * node + 1])
            right = _square_to_box(points[row], boxes[2 * node + 2])
            nearer = 2 * node + 1 if left <= right else 2 * node + 2
            waiting[count] = 4 * node + 3 - nearer  # the other one of the two
            waiting[count + 1] = nearer
            count += 2
        largest = max(largest, best)
    return np.sqrt(largest)


@compiled
def add_normals(
    positions: Matrix,
    reach: float,
    boxes: Matrix,
    middles: Matrix,
    areas: Matrix,
    means: WrittenMatrix,
) -> int:
    """Find the mean normals around positions.

    Args:
        positions: Shape (n, 3).
        reach: Radius around each.
        boxes: Least and largest coordinates of the nodes, (2 leaves - 1, 6).
        middles: Of the triangles, in the order of the leaves, (m, 3).
        areas: Their normals times their areas, (m, 3).
        means: The normals at the positions; their means are written, (n, 3).

    Returns:
        How many triangles counted in all.
    """
    first_leaf = len(boxes) // 2
    leaf_triangles = len(middles) // (first_leaf + 1)
    waiting = np.empty(MAX_DEPTH)
    counted = 0
    for row in range(len(positions)):
        total = np.zeros(4)  # normals times areas, and areas
        waiting[0] = 0.0
        count = 1
        while count > 0:
            count -= 1
            node = int(waiting[count])
            if _square_to_box(positions[row], boxes[node]) > reach * reach:
                continue
            if node < first_leaf:
                waiting[count] = 2 * node + 1
                waiting[count + 1] = 2 * node + 2
                count += 2
                continue
            start = (node - first_leaf) * leaf_triangles
            for number in range(start, start + leaf_triangles):
                counted += _add_normal(
                    positions[row],
                    means[row],
                    reach,
                    middles[number],
                    areas[number],
                    total,
                )
        if total[3] > 0.0:
            for axis in range(3):
                means[row, axis] = total[axis] / total[3]
    return counted


@compiled_inside
def _add_normal(
    position: Vector,
    normal: Vector,
    reach: float,
    middle: Vector,
    area: Vector,
    total: WrittenVector,
) -> int:
    """Add a triangle to the mean normal around a position if it counts there.

    Args:
        position: Shape (3,).
        normal: There, (3,).
        reach: Radius around the position.
        middle: Of the triangle, (3,).
        area: Its normal times its area, (3,).
        total: Sums of normals times areas, and of areas, changed, (4,).

    Returns:
        1 if it counts, otherwise 0.
    """
    distance = 0.0
    facing = 0.0
    square = 0.0
    for axis in range(3):
        distance += (middle[axis] - position[axis]) ** 2
        facing += area[axis] * normal[axis]
        square += area[axis] ** 2
    if distance > reach * reach or not facing > 0.0:
        return 0
    for axis in range(3):
        total[axis] += area[axis]
    total[3] += np.sqrt(square)
    return 1


@compiled_inside
def _square_to_box(point: Vector, box: Vector) -> float:
    """Return the square of the distance between a point and a box."""
    square = 0.0
    for axis in range(3):
        gap = max(box[axis] - point[axis], point[axis] - box[axis + 3], 0.0)
        square += gap * gap
    return square


@compiled_inside
def _nearest_on(point: Vector, corners: Vector, place: WrittenVector) -> float:
    """Find the place on a triangle nearest to a point.

    It is the foot of the perpendicular, or where that lies beside the triangle a place
    on an edge.

    Args:
        point: Shape (3,).
        corners: Three corners after each other, (9,).
        place: The place, written, (3,).

    Returns:
        The square of the distance.
    """
    first_square = 0.0
    second_square = 0.0
    product = 0.0  # of the two edges from the first corner
    on_first = 0.0  # products of these and the way from there to the point
    on_second = 0.0
    for axis in range(3):
        first = corners[axis + 3] - corners[axis]
        second = corners[axis + 6] - corners[axis]
        way = point[axis] - corners[axis]
        first_square += first * first
        second_square += second * second
        product += first * second
        on_first += first * way
        on_second += second * way
    whole = first_square * second_square - product * product
    along_first = second_square * on_first - product * on_second
    along_second = first_square * on_second - product * on_first
    if along_first > 0.0 and along_second > 0.0 and along_first + along_second < whole:
        square = 0.0
        for axis in range(3):
            first = corners[axis + 3] - corners[axis]
            second = corners[axis + 6] - corners[axis]
            offset = (along_first * first + along_second * second) / whole
            place[axis] = corners[axis] + offset
            square += (point[axis] - place[axis]) ** 2
        return square
    best = np.inf
    for edge in range(3):
        best = _nearest_on_edge(point, corners, edge, best, place)
    return best


@compiled_inside
def _nearest_on_edge(
    point: Vector, corners: Vector, edge: int, best: float, place: WrittenVector
) -> float:
    """Find the place on an edge of a triangle nearest to a point, if it is nearer.

    Args:
        point: Shape (3,).
        corners: Three corners after each other, (9,).
        edge: Number of the edge, from the corner of that number to the next.
        best: Square of the distance below which a place is nearer.
        place: The place, written where it is nearer, (3,).

    Returns:
        The smaller one of its square of the distance and the given one.
    """
    start = 3 * edge
    end = 3 * ((edge + 1) % 3)
    along = 0.0
    length = 0.0
    for axis in range(3):
        way = corners[end + axis] - corners[start + axis]
        along += way * (point[axis] - corners[start + axis])
        length += way * way
    fraction = min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0
    square = 0.0
    for axis in range(3):
        way = corners[end + axis] - corners[start + axis]
        gap = point[axis] - corners[start + axis] - fraction * way
        square += gap * gap
    if square >= best:
        return best
    for axis in range(3):
        way = corners[end + axis] - corners[start + axis]
        place[axis] = corners[start + axis] + fraction * way
    return square
