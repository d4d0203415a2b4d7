"""The patient: labelled volumes, surfaces, layers along a needle, registration, plan
and ruptures.

    labels = read_labels("abdomen.seg.nrrd")
    surfaces = labels.surfaces()                       # name to closed surface
    for layer in labels.layers_along(entry_m, target_m):
        print(layer.name, layer.entry_m, layer.exit_m, layer.is_obstacle)

Points are in the patient's frame LPS (x to the left, y to the back, z to the head), in
metres. Stands alone: no robots, no forces. Not a medical device.

Reading order: `volume`, `reading`, `surface`, `registration`, `plan_match`, `errors`.
"""

from needleforce.anatomy.errors import (
    AnatomyError,
    PlanError,
    RegistrationError,
    VolumeError,
)
from needleforce.anatomy.plan_match import PlanMatch, PlanState
from needleforce.anatomy.reading import read_labels, read_volume
from needleforce.anatomy.registration import Registration, fit_landmarks, fit_surface
from needleforce.anatomy.surface import Surface
from needleforce.anatomy.volume import Grid, Labels, Layer, Structure, Volume

__all__ = [
    "AnatomyError",
    "Grid",
    "Labels",
    "Layer",
    "PlanError",
    "PlanMatch",
    "PlanState",
    "Registration",
    "RegistrationError",
    "Structure",
    "Surface",
    "Volume",
    "VolumeError",
    "fit_landmarks",
    "fit_surface",
    "read_labels",
    "read_volume",
]
