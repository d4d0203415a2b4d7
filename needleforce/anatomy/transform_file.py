"""Where the CT lies in the robot's base, from a transform that another program wrote.

Files of ITK (``.h5``, ``.tfm``) hold x_out = A (x_in - c) + t + c in LPS and
millimetres. 3D Slicer writes into them the inverse of what it shows, and shows
RAS, in which x and y have the other sign.
"""

from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.markups import RAS_TO_LPS

TransformSource = Literal["slicer", "itk"]
"""Who wrote a transform, and so which way round it is."""


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
    m_per_mm = 1e-3
    max_stretch = 1e-3  # lengths change by no more: files round their numbers
    max_distance_m = 10.0  # a CT further from the base is not in millimetres
    import SimpleITK

    try:
        # The HDF5 library prints pages about other files.
        is_hdf5 = Path(path).read_bytes()[:4] == b"\x89HDF"
        if is_hdf5 != str(path).endswith((".h5", ".hdf5")):
            raise OSError("it is not what its name says")
        transform = SimpleITK.ReadTransform(str(path))
    except (OSError, RuntimeError) as error:
        raise VolumeError(
            f"cannot read {path}: expected a transform of ITK, as .h5 or .tfm"
        ) from error
    if transform.GetDimension() != 3 or not transform.IsLinear():
        raise VolumeError(f"{path} is a {transform.GetName()}: expected a rigid motion")
    shift_mm = np.array(transform.TransformPoint(np.zeros(3).tolist()))
    images_mm = [transform.TransformPoint(axis.tolist()) for axis in np.eye(3)]
    left, stretches, right = np.linalg.svd((np.array(images_mm) - shift_mm).T)
    rotation = left @ right
    distance_m = m_per_mm * np.linalg.norm(shift_mm)
    is_rigid = np.abs(stretches - 1.0).max() <= max_stretch
    if not is_rigid or np.linalg.det(rotation) < 0.0 or distance_m > max_distance_m:
        raise VolumeError(
            f"{path} stretches by {stretches.min():.4g} to {stretches.max():.4g}, is a "
            f"mirror image, or carries the CT {distance_m:.3g} m away: expected a "
            "rigid motion in millimetres"
        )
    if source == "slicer":
        rotation = RAS_TO_LPS[:, None] * rotation.T
        shift_mm = -rotation @ shift_mm
    return RigidTransform(rotation, m_per_mm * shift_mm)
