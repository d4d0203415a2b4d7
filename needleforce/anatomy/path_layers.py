"""Which structures a straight needle crosses, from the label volume.

At each place along the path every structure has a vote: the fraction of a Gaussian around that
place which its voxels fill. The structure with the largest is where the tip is; where two change
places is the boundary. Votes of all structures add up to one, so layers neither overlap nor leave
gaps. (Rays against surfaces of single structures do both, and are the test of this.)
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needleforce.anatomy.errors import PathError
from needleforce.anatomy.volume import Array, Labels

BLUR_VOXELS = 0.8
"""Standard deviation of the Gaussian."""
REACH = 2
"""Neighbours on each side that vote."""
STEPS_PER_VOXEL = 3.0
VOTE_STD = 0.11
"""Error of the difference of two votes that voxels make; calibrated on analytic bodies."""
THINNEST_VOXELS = 0.35
"""What is thinner along the path is a corner of a voxel, no layer."""
LONGEST_m = 1.0


class PathLayer(NamedTuple):
    """One structure along a needle; depths count from the entry point."""

    name: str
    number: int  # of the structure; 0 for what is not labelled
    entry_m: float
    exit_m: float  # of the last layer: the target
    entry_std_m: float  # of the boundary; 0 where the path begins
    exit_std_m: float  # 0 where it ends
    is_obstacle: bool  # bone or cartilage


def layers_along(labels: Labels, entry_m: ArrayLike, target_m: ArrayLike) -> list[PathLayer]:
    """The structures from entry to target, in order, without gaps or overlaps.

    Args:
        labels: The segmentation.
        entry_m: Where the needle begins [m], LPS, shape (3,); it may lie outside the body.
        target_m: Where it ends.

    Raises:
        PathError: Points that are not finite, the same, more than a metre apart, or a target
            outside the volume.
    """
    start, end = _checked(labels, entry_m, target_m)
    length_m = float(np.linalg.norm(end - start))
    voxel_m = float(labels.grid.spacing_m.min())
    count = max(int(np.ceil(STEPS_PER_VOXEL * length_m / voxel_m)), 2) + 1
    depth_m = np.linspace(0.0, length_m, count)
    numbers, votes = _votes(labels, start + depth_m[:, None] / length_m * (end - start))
    winner = _without_slivers(votes.argmax(axis=1), THINNEST_VOXELS * STEPS_PER_VOXEL)
    changes = np.flatnonzero(np.diff(winner))
    crossings = [
        _crossing(depth_m, votes, int(at), int(winner[at]), int(winner[at + 1])) for at in changes
    ]
    # Two crossings in neighbouring steps may overtake each other by a fraction of a step.
    depths = np.maximum.accumulate([0.0, *(place for place, _ in crossings), length_m])
    stds = [0.0, *(std for _, std in crossings), 0.0]
    layers = []
    for k, column in enumerate([winner[0], *winner[changes + 1]]):
        number = int(numbers[column])
        layers.append(
            PathLayer(
                name=labels.name_of(number),
                number=number,
                entry_m=float(depths[k]),
                exit_m=float(depths[k + 1]),
                entry_std_m=stds[k],
                exit_std_m=stds[k + 1],
                is_obstacle=labels.is_obstacle(number),
            )
        )
    return layers


def _checked(labels: Labels, entry_m: ArrayLike, target_m: ArrayLike) -> tuple[Array, Array]:
    start, end = (np.asarray(point, dtype=float) for point in (entry_m, target_m))
    if start.shape != (3,) or end.shape != (3,) or not np.isfinite([start, end]).all():
        raise PathError(f"entry {entry_m!r} and target {target_m!r}: expected three metres each")
    length_m = float(np.linalg.norm(end - start))
    if not 0.0 < length_m <= LONGEST_m:
        raise PathError(
            f"entry and target are {length_m:.3g} m apart; expected more than 0 and at most "
            f"{LONGEST_m:g} m: are they in millimetres?"
        )
    index = labels.grid.to_index(end)
    if (index < -0.5).any() or (index > np.array(labels.grid.shape) - 0.5).any():
        raise PathError(
            f"the target {end.tolist()} m lies outside the volume, which reaches from "
            f"{labels.grid.to_world([0, 0, 0]).tolist()} to "
            f"{labels.grid.to_world(np.array(labels.grid.shape) - 1).tolist()} m; is it in LPS?"
        )
    return start, end


def _votes(labels: Labels, points_m: Array) -> tuple[NDArray[np.int64], Array]:
    """Numbers of the structures near some points, and their votes there, shape (n, k)."""
    index = labels.grid.to_index(points_m)
    nearest = np.rint(index).astype(np.int64)
    reach = np.arange(-REACH, REACH + 1)
    weights, places = [], []
    for axis in range(3):
        place = nearest[:, axis, None] + reach
        weight = np.exp(-0.5 * ((place - index[:, axis, None]) / BLUR_VOXELS) ** 2)
        weights.append(weight / weight.sum(axis=1, keepdims=True))
        # Beyond the border the volume goes on as it ends there.
        places.append(np.clip(place, 0, labels.grid.shape[axis] - 1))
    i, j, k = (place.astype(np.intp) for place in places)
    found = labels.numbers[i[:, :, None, None], j[:, None, :, None], k[:, None, None, :]]
    whole = np.einsum("ni,nj,nk->nijk", *weights)
    numbers, column = np.unique(found, return_inverse=True)
    count, size = len(points_m), len(numbers)
    flat = column.reshape(found.shape) + size * np.arange(count)[:, None, None, None]
    votes = np.bincount(flat.ravel(), whole.ravel(), minlength=count * size)
    return numbers.astype(np.int64), np.asarray(votes.reshape(count, size), dtype=float)


def _without_slivers(winner: NDArray[np.int64], least: float) -> NDArray[np.int64]:
    """Winners in which no run but the first is shorter than so many steps: it joins the last."""
    winner = winner.copy()
    edges = [*(np.flatnonzero(np.diff(winner)) + 1), len(winner)]
    for begin, end in pairwise(edges):
        if end - begin < least:
            winner[begin:end] = winner[begin - 1]
    return winner


def _crossing(
    depth_m: Array, votes: Array, at: int, before: int, after: int
) -> tuple[float, float]:
    """Depth at which the second of two structures begins to outvote the first, and its deviation.

    The vote's slope says how squarely the boundary is met: along a grazing path it is flat, and an
    error of the votes moves the crossing far.
    """
    lead = votes[:, before] - votes[:, after]
    one, two = lead[at], lead[at + 1]
    fraction = 0.5 if one <= two else min(max(one / (one - two), 0.0), 1.0)
    step_m = float(depth_m[1])
    around = slice(max(at - 1, 0), min(at + 3, len(lead)))
    slope = -float(np.polyfit(depth_m[around], lead[around], 1)[0])
    std_m = VOTE_STD / max(slope, 0.05 / step_m)
    return float(depth_m[at] + fraction * step_m), std_m
