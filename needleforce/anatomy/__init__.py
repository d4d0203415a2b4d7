"""Volumes, surfaces, what a needle crosses, registration, and a plan that ruptures correct.

Stands alone: points and depths in metres, LPS; no robots, no forces. Not a medical device.

Reading order: `volume` (scans and segmentations), `surface`, `path_layers`, `landmarks`,
`surface_fit`, `plan_match`; `errors`.
"""

from needleforce.anatomy.errors import (
    AnatomyError,
    PathError,
    PlanError,
    RegistrationError,
    StructureError,
    VolumeError,
)
from needleforce.anatomy.landmarks import Registration, fit_landmarks
from needleforce.anatomy.path_layers import PathLayer, layers_along
from needleforce.anatomy.plan_match import PlanMatch, PlanState
from needleforce.anatomy.surface import Surface, surface_of, surfaces
from needleforce.anatomy.surface_fit import TouchSurface, fit_surface
from needleforce.anatomy.volume import Grid, Image, Labels, Structure, read_image, read_labels

__all__ = [
    "AnatomyError",
    "Grid",
    "Image",
    "Labels",
    "PathError",
    "PathLayer",
    "PlanError",
    "PlanMatch",
    "PlanState",
    "Registration",
    "RegistrationError",
    "Structure",
    "StructureError",
    "Surface",
    "TouchSurface",
    "VolumeError",
    "fit_landmarks",
    "fit_surface",
    "layers_along",
    "read_image",
    "read_labels",
    "surface_of",
    "surfaces",
]
