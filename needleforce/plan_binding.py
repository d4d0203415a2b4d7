"""What a plan was made of, and whether the files beside it are still those.

`needleforce plan` writes what it used into the plan: CT and labels with a SHA-256 of
their voxels and their geometry, and a SHA-256 of path, layers and needle. What reads
the plan compares. Where a sum differs, what counts is found out anew: geometry, skin,
target, layers. What does not fit is refused.
"""

import json
from collections.abc import Sequence
from hashlib import sha256
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.arrays import Array
from needleforce.anatomy import Grid, Labels, Layer, Registration, Volume

SKIN_m = 5e-3
"""So far in front of the entry there is air, also where skin lies between voxels."""


AGAIN = "plan again with `needleforce plan`, and register"


class VolumeRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A volume that a plan was made of.

    Attributes:
        sha256: Of its voxels, of labels also of the names.
        shape: Voxels along each axis.
        origin_m: Of the first voxel, in LPS.
        axes_m: Columns are steps along the axes.
    """

    sha256: str
    shape: tuple[int, ...]
    origin_m: tuple[float, ...]
    axes_m: tuple[tuple[float, ...], ...]

    @property
    def grid(self) -> Grid:
        """Where the voxels lie."""
        return Grid(self.shape, np.array(self.origin_m), np.array(self.axes_m))


class MadeOf(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a plan was made of.

    Attributes:
        ct: The CT.
        labels: The segmentation, as in its file.
        path_sha256: Of entry, target, layers, needle and margin.
        avoided: Names of the structures that had to stay clear.
    """

    ct: VolumeRecord
    labels: VolumeRecord
    path_sha256: str
    avoided: tuple[str, ...]


def record_scan(scan: Volume) -> VolumeRecord:
    """Return what a plan keeps of a CT."""
    return _record(scan.grid, [scan.values], "")


def record_labels(labels: Labels) -> VolumeRecord:
    """Return what a plan keeps of a segmentation."""
    names = [(item.name, item.value, item.volume) for item in labels.structures]
    volumes = [np.asarray(volume).astype(np.uint32) for volume in labels.volumes]
    return _record(labels.grid, volumes, json.dumps(names))


def _record(grid: Grid, volumes: Sequence[NDArray[Any]], text: str) -> VolumeRecord:
    """Return what a plan keeps of volumes on one grid."""
    digest = sha256(text.encode())
    for volume in volumes:
        digest.update(np.ascontiguousarray(volume).tobytes())
    return VolumeRecord(
        digest.hexdigest(),
        tuple(map(int, grid.shape)),
        tuple(np.asarray(grid.origin_m, float).tolist()),
        tuple(map(tuple, np.asarray(grid.axes_m, float).tolist())),
    )


def path_sha256(
    entry_m: ArrayLike,
    target_m: ArrayLike,
    layers: Sequence[tuple[str, float]],
    needle_radius_m: float,
    margin_m: float,
) -> str:
    """Return the sum of a path.

    Args:
        entry_m: In LPS, (3,).
        target_m: In LPS, (3,).
        layers: Name and end of each.
        needle_radius_m: Of the needle.
        margin_m: That stays free around it.
    """
    numbers = np.array([entry_m, target_m], float).tolist()
    kept = [(name, float(exit_m)) for name, exit_m in layers]
    text = json.dumps([numbers, kept, float(needle_radius_m), float(margin_m)])
    return sha256(text.encode()).hexdigest()


def check_files(
    made_of: MadeOf,
    scan: Volume,
    labels: Labels,
    *,
    path_sum: str,
    path: tuple[Array, Array],
    layers: Sequence[Layer],
) -> list[str]:
    """Return warnings of what has changed since a plan was made, without effect.

    Args:
        made_of: What it was made of.
        scan: The CT that lies beside it now.
        labels: The labels that lie beside it now.
        path_sum: Of the path as the plan has it now.
        path: Its entry and target, in LPS.
        layers: Those that the plan states.

    Raises:
        ValueError: Something does not fit; it says what.
    """
    changed: list[str] = []
    for name, now, then in (
        ("CT", record_scan(scan), made_of.ct),
        ("labels", record_labels(labels), made_of.labels),
    ):
        _require_geometry(name, now.grid, then.grid)
        if now.sha256 != then.sha256:
            changed.append(f"the voxels of the {name}")
    if path_sum != made_of.path_sha256:
        changed.append("path, layers or needle in the plan")
    if not changed:
        return []
    text = f"{' and '.join(changed)} have changed since the plan was made"
    whole = labels.with_body(scan, fat=True).with_dense(scan)
    _require_ends(whole, *path, text)
    _require_layers(whole.layers_along(*path), layers, text)
    return [f"{text}; geometry, skin and layers along the path are the same"]


def _require_geometry(name: str, now: Grid, then: Grid) -> None:
    """Refuse a volume that lies elsewhere than the one that a plan was made of."""
    # By so much corners of a grid may lie elsewhere: files hold decimals
    max_shift_m = 0.1e-3
    if now.shape != then.shape:
        voxels_then = " x ".join(map(str, then.shape))
        voxels_now = " x ".join(map(str, now.shape))
        raise ValueError(
            f"it was made of a {name} of {voxels_then} voxels, and there are "
            f"{voxels_now}: another patient or scan; {AGAIN}"
        )
    shift_m = float(np.linalg.norm(now.corners_m() - then.corners_m(), axis=1).max())
    if shift_m > max_shift_m:
        raise ValueError(
            f"{1e3 * shift_m:.1f} mm lie between the {name} now and when the plan was "
            f"made: another scan; {AGAIN}"
        )


def _require_ends(labels: Labels, entry_m: Array, target_m: Array, text: str) -> None:
    """Refuse a path that does not lead from the air in front of the skin inside."""
    axis = (target_m - entry_m) / np.linalg.norm(target_m - entry_m)
    if _is_inside(labels, entry_m - SKIN_m * axis):
        raise ValueError(
            f"{text}, and the entry does not lie at the skin: entry and target "
            f"exchanged, or another patient; {AGAIN}"
        )
    if not _is_inside(labels, target_m):
        raise ValueError(f"{text}, and the target lies outside the body; {AGAIN}")


def _is_inside(labels: Labels, point_m: Array) -> bool:
    """Return whether a point lies in a labelled voxel, or in the body."""
    index = np.rint(labels.grid.indices(point_m)).astype(int)
    if np.any(index < 0) or np.any(index >= labels.grid.shape):
        return False
    voxel = tuple(index.tolist())
    return any(bool(volume[voxel]) for volume in labels.volumes)


def _require_layers(now: Sequence[Layer], then: Sequence[Layer], text: str) -> None:
    """Refuse a plan whose layers are not those along its path."""
    # By so much a boundary may lie elsewhere in labels that were touched up
    max_layer_shift_m = 2e-3
    names_now = [layer.name for layer in now]
    names_then = [layer.name for layer in then]
    if names_now != names_then:
        raise ValueError(
            f"{text}, and the path runs through {', '.join(names_now)}, not through "
            f"{', '.join(names_then)} as the plan says; {AGAIN}"
        )
    for one, other in zip(now, then, strict=True):
        if abs(one.exit_m - other.exit_m) > max_layer_shift_m:
            raise ValueError(
                f"{text}, and {one.name} ends at {1e3 * one.exit_m:.1f} mm, not at "
                f"{1e3 * other.exit_m:.1f} mm as the plan says; {AGAIN}"
            )


class RegisteredPlace(msgspec.Struct, frozen=True):
    """Where registration has put the path.

    Attributes:
        entry_in_base_m: The entry in the robot's base.
        target_in_base_m: The target in the robot's base.
        entry_error_rms_m: Error to be expected at the entry.
        target_error_rms_m: At the target.
    """

    entry_in_base_m: tuple[float, ...]
    target_in_base_m: tuple[float, ...]
    entry_error_rms_m: float
    target_error_rms_m: float


def check_registration(
    registered: dict[str, Any] | None,
    registration: Registration,
    entry_m: Array,
    target_m: Array,
) -> None:
    """Refuse a registration whose numbers were changed after it was made.

    Args:
        registered: What `needleforce register` wrote beside it.
        registration: As the plan has it now.
        entry_m: In LPS.
        target_m: In LPS.

    Raises:
        ValueError: A place or an error is not the registered one.
    """
    # By this factor an error of the covariance may differ from the registered one
    max_error_ratio = 1.01
    # By so much entry and target may lie elsewhere in the robot's base than registered
    max_point_shift_m = 0.1e-3
    again = "register again with `needleforce register`"
    try:
        place = msgspec.convert(registered, RegisteredPlace)
    except msgspec.ValidationError as error:
        raise ValueError(
            "it does not say where its registration has put the path (made by an "
            f"earlier version?): {again}"
        ) from error
    if registration.covariance.shape != (6, 6):
        raise ValueError(f"no covariance of the registration in it: {again}")
    for name, point_m, then_m, error_m in (
        ("entry", entry_m, place.entry_in_base_m, place.entry_error_rms_m),
        ("target", target_m, place.target_in_base_m, place.target_error_rms_m),
    ):
        shift_m = float(np.linalg.norm(registration.to_robot(point_m) - then_m))
        if shift_m > max_point_shift_m:
            raise ValueError(
                f"its {name} lies {1e3 * shift_m:.1f} mm from where it was registered "
                "in the robot's base: rotation, translation or path were changed (RAS "
                f"for LPS, ends exchanged, a point moved?); {again}"
            )
        now_m = registration.tre_m(point_m)
        if not error_m / max_error_ratio <= now_m <= error_m * max_error_ratio:
            raise ValueError(
                f"its covariance says {1e3 * now_m:.3g} mm error at the {name}, its "
                f"registration {1e3 * error_m:.3g} mm: the covariance was changed; "
                f"{again}"
            )
