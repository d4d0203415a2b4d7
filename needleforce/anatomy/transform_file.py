"""Where the CT lies in the robot's base, from a transform that another program wrote.

Files of ITK (``.h5``, ``.tfm``) hold x_out = A (x_in - c) + t + c in LPS and
millimetres. 3D Slicer writes into them the inverse of what it shows, and shows
RAS, in which x and y have the other sign.
"""

from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.anatomy.errors import SAVE_TRANSFORM, VolumeError
from needleforce.anatomy.markups import RAS_TO_LPS

TransformSource = Literal["slicer", "itk"]
"""Who wrote a transform, and so which way round it is."""

M_PER_MM = 1e-3


class RigidTransform(NamedTuple):
    """A motion: y = R x + t.

    Attributes:
        rotation: R, from LPS to the robot's base, (3, 3).
        translation_m: t, (3,).
    """

    rotation: Array
    translation_m: Array


def read_transform(path: Path | str, source: TransformSource) -> RigidTransform:
    """Read the motion from the CT (LPS) to the robot's base.

    Args:
        path: The file.
        source: ``slicer``: 3D Slicer saved the transform under which the CT lies where
            the robot sees it, with the robot's x, y, z as R, A, S. ``itk``: its
            ``TransformPoint`` carries a point of the CT to the robot's base.

    Raises:
        VolumeError: Not readable, not linear, stretched, sheared or mirrored, or not in
            millimetres.
    """
    # By so much lengths may change in a rigid motion: files round their numbers.
    max_stretch = 1e-3
    transform = _open(Path(path))
    if transform.GetDimension() != 3 or not transform.IsLinear():
        raise VolumeError(
            f"{path} holds a {transform.GetName()}: expected a rigid motion in three "
            "dimensions",
            SAVE_TRANSFORM,
        )
    matrix, shift_mm = _affine_of(transform)
    stretches = np.linalg.svd(matrix, compute_uv=False)
    if np.abs(stretches - 1.0).max() > max_stretch:
        raise VolumeError(
            f"{path} stretches by {stretches.min():.4g} to {stretches.max():.4g}: "
            "expected a rigid motion; fit it again without scaling and shear",
            SAVE_TRANSFORM,
        )
    if np.linalg.det(matrix) < 0.0:
        raise VolumeError(
            f"{path} is a mirror image: expected a rigid motion", SAVE_TRANSFORM
        )
    left, _, right = np.linalg.svd(matrix)
    rotation = left @ right
    if source == "slicer":
        rotation = RAS_TO_LPS[:, None] * rotation.T
        shift_mm = -rotation @ shift_mm
    translation_m = M_PER_MM * shift_mm
    max_distance_m = 10.0  # a CT further from the base is not in millimetres
    if np.linalg.norm(translation_m) > max_distance_m:
        raise VolumeError(
            f"{path} carries the CT {np.linalg.norm(translation_m):.3g} m away: "
            "expected a file in millimetres",
            SAVE_TRANSFORM,
        )
    return RigidTransform(rotation, translation_m)


def _affine_of(transform: Any) -> tuple[Array, Array]:
    """Return matrix (3, 3) and shift (3,) [mm] of a linear transform of ITK."""
    shift_mm = np.array(transform.TransformPoint([0.0, 0.0, 0.0]))
    columns = [
        np.array(transform.TransformPoint(axis.tolist())) - shift_mm
        for axis in np.eye(3)
    ]
    return np.column_stack(columns), shift_mm


def _open(path: Path) -> Any:
    """Return the transform of SimpleITK in a file.

    Raises:
        VolumeError: There is none.
    """
    hdf5_magic = b"\x89HDF\r\n\x1a\n"
    hdf5_endings = (".h5", ".hdf5")
    import SimpleITK

    reason = "no such file"
    try:
        with path.open("rb") as file:
            start = file.read(len(hdf5_magic))
        # The HDF5 library prints pages about other files.
        if path.suffix in hdf5_endings and start != hdf5_magic:
            reason = "it is no HDF5 file"
        else:
            return SimpleITK.ReadTransform(str(path))
    except OSError as error:
        reason = error.strerror or reason
    except RuntimeError as error:
        reason = next(
            (line for line in str(error).splitlines() if "ITK ERROR" in line),
            "it holds no transform",
        )
    raise VolumeError(
        f"cannot read {path}: {reason}; expected a transform as .h5 or .tfm",
        SAVE_TRANSFORM,
    )
