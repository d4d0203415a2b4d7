"""Where the CT lies in the robot's base, from a transform that another program wrote.

Files of ITK (``.h5``, ``.tfm``) hold x_out = A (x_in - c) + t + c in LPS and
millimetres. 3D Slicer writes into them the inverse of what it shows, and shows
RAS, in which x and y have the other sign.
"""

from pathlib import Path
from typing import Literal

import numpy as np

from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.markups import RAS_TO_LPS
from needleforce.anatomy.registration import RigidTransform

TransformSource = Literal["slicer", "itk"]
"""Who wrote a transform, and so which way round it is."""


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
    max_stretch = 1e-3  # lengths change by no more: files round their numbers
    max_distance_mm = 1e4  # a CT further from the base is not in millimetres
    import SimpleITK

    try:
        # The HDF5 library prints pages about other files.
        is_hdf5 = Path(path).read_bytes()[:4] == b"\x89HDF"
        if is_hdf5 != str(path).endswith((".h5", ".hdf5")):
            raise OSError("it is not what its name says")
        transform = SimpleITK.ReadTransform(str(path))
        shift_mm = np.array(transform.TransformPoint([0.0, 0.0, 0.0]))
        images_mm = [transform.TransformPoint(axis) for axis in np.eye(3).tolist()]
    except (OSError, RuntimeError, TypeError) as error:
        raise VolumeError(
            f"cannot read {path}: expected a transform of ITK in three dimensions, as "
            ".h5 or .tfm"
        ) from error
    left, stretches, right = np.linalg.svd((np.array(images_mm) - shift_mm).T)
    rotation = left @ right
    is_near = np.linalg.norm(shift_mm) <= max_distance_mm
    is_rigid = transform.IsLinear() and np.abs(stretches - 1.0).max() <= max_stretch
    if not (is_near and is_rigid and np.linalg.det(rotation) > 0.0):
        raise VolumeError(
            f"{path} is a {transform.GetName()} that stretches by "
            f"{stretches.min():.4g} to {stretches.max():.4g} and carries the CT by "
            f"{shift_mm.tolist()} mm: expected a rigid motion in millimetres, and no "
            "mirror image"
        )
    if source == "slicer":
        rotation = RAS_TO_LPS[:, None] * rotation.T
        shift_mm = -rotation @ shift_mm
    return RigidTransform(rotation, 1e-3 * shift_mm)
