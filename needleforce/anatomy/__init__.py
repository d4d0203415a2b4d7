"""The patient: labelled volumes, closed surfaces, and the layers that a planned needle crosses.

    labels = read_labels("abdomen.seg.nrrd")
    surfaces = labels.surfaces()                       # name to closed surface
    for layer in labels.layers_along(entry_m, target_m):
        print(layer.name, layer.entry_m, layer.exit_m, layer.is_obstacle)

Points are in the patient's frame LPS (x to the left, y to the back, z to the head), in metres.
Not a medical device.

Reading order: `volume`, `surface`, `path_layers`, `errors`.
"""

from needleforce.anatomy.errors import AnatomyError, RefusedError, VolumeError
from needleforce.anatomy.path_layers import Layer
from needleforce.anatomy.surface import Surface
from needleforce.anatomy.volume import Grid, Labels, Structure, Volume, read_labels, read_volume

__all__ = [
    "AnatomyError",
    "Grid",
    "Labels",
    "Layer",
    "RefusedError",
    "Structure",
    "Surface",
    "Volume",
    "VolumeError",
    "read_labels",
    "read_volume",
]
