"""The patient: volumes, surfaces, layers along a needle, registration, plan.

    labels = read_labels("abdomen.seg.nrrd")
    surfaces = labels.surfaces()                       # name to closed surface
    for layer in labels.layers_along(entry_m, target_m):
        print(layer.name, layer.entry_m, layer.exit_m, layer.is_obstacle)

Points are in the patient's frame LPS (x to the left, y to the back, z to the head), in
metres. Stands alone: no robots, no forces. Not a medical device.

Reading order: `volume`, `path_layers`, `registration`, `clearance`, `surface`,
`labels`, `image_files`, `surface_fit`, `markups`, `touch_detector`, `path_search`,
`plan_match`.
"""

from needleforce.anatomy.clearance import (
    Clearance,
    FreeSpace,
    NeedleClearance,
    NeedleSurroundings,
    VoxelBoxes,
    require_clear_path,
)
from needleforce.anatomy.errors import (
    AnatomyError,
    PlanError,
    RegistrationError,
    VolumeError,
)
from needleforce.anatomy.image_files import read_labels, read_volume
from needleforce.anatomy.labels import Labels
from needleforce.anatomy.markups import (
    Markup,
    read_markup,
    read_transform,
    write_markup,
)
from needleforce.anatomy.path_layers import Layer
from needleforce.anatomy.path_search import PathLimits, SkinPath, find_paths
from needleforce.anatomy.plan_match import OUTSIDE, PlanMatch, PlanState
from needleforce.anatomy.registration import (
    LandmarkResidual,
    Registration,
    fit_landmarks,
    judge_landmarks,
    require_lps,
)
from needleforce.anatomy.surface import Surface
from needleforce.anatomy.surface_fit import fit_surface
from needleforce.anatomy.touch_detector import TipTouch, TouchDetector
from needleforce.anatomy.volume import Grid, Structure, Volume

__all__ = [
    "OUTSIDE",
    "AnatomyError",
    "Clearance",
    "FreeSpace",
    "Grid",
    "Labels",
    "LandmarkResidual",
    "Layer",
    "Markup",
    "NeedleClearance",
    "NeedleSurroundings",
    "PathLimits",
    "PlanError",
    "PlanMatch",
    "PlanState",
    "Registration",
    "RegistrationError",
    "SkinPath",
    "Structure",
    "Surface",
    "TipTouch",
    "TouchDetector",
    "Volume",
    "VolumeError",
    "VoxelBoxes",
    "find_paths",
    "fit_landmarks",
    "fit_surface",
    "judge_landmarks",
    "read_labels",
    "read_markup",
    "read_transform",
    "read_volume",
    "require_clear_path",
    "require_lps",
    "write_markup",
]
