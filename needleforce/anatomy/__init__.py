"""The patient: volumes, surfaces, layers along a needle, registration, plan.

    labels = read_labels("abdomen.seg.nrrd")
    surfaces = labels.surfaces()                       # name to closed surface
    for layer in labels.layers_along(entry_m, target_m):
        print(layer.name, layer.entry_m, layer.exit_m, layer.is_obstacle)

Points are in the patient's frame LPS (x to the left, y to the back, z to the head), in
metres. Stands alone: no robots, no forces. Not a medical device.

Reading order: `volume`, `structures`, `body`, `label_checks`,
`path_layers`, `clearance`, `surface`, `labels`, `scan_files`,
`label_files`, `registration`, `landmarks`, `landmark_frame`, `touch_problem`,
`patient_motion`, `surface_fit`, `markups`, `path_search`,
`needle_surroundings`, `plan_match`, `rupture_model`.
"""

from needleforce.anatomy.clearance import (
    Clearance,
    FreeSpace,
    VoxelBoxes,
    require_clear_path,
)
from needleforce.anatomy.errors import (
    AnatomyError,
    PlanError,
    RegistrationError,
    VolumeError,
)
from needleforce.anatomy.label_files import read_labels
from needleforce.anatomy.labels import Labels
from needleforce.anatomy.landmark_frame import require_lps
from needleforce.anatomy.landmarks import (
    LandmarkResidual,
    fit_landmarks,
    judge_landmarks,
)
from needleforce.anatomy.markups import (
    Markup,
    read_markup,
    read_transform,
    write_markup,
)
from needleforce.anatomy.needle_surroundings import (
    NeedleClearance,
    NeedleSurroundings,
)
from needleforce.anatomy.path_layers import Layer
from needleforce.anatomy.path_search import PathLimits, SkinPath, find_paths
from needleforce.anatomy.plan_match import OUTSIDE, PlanMatch, PlanState
from needleforce.anatomy.registration import Registration
from needleforce.anatomy.scan_files import read_volume
from needleforce.anatomy.structures import Structure
from needleforce.anatomy.surface import Surface
from needleforce.anatomy.surface_fit import fit_surface
from needleforce.anatomy.touch_detector import TipTouch, TouchDetector
from needleforce.anatomy.volume import Grid, Volume

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
