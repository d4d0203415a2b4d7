"""The insertion in a browser page, live or recorded, and in 3D Slicer.

Reading order: `state_ring` (what a loop hands over), `nodes` (what stands in the scene), `viewer`
(the page), `live` (the page beside a loop), `slicer` (OpenIGTLink).
"""

from needleforce.scene.live import LiveView, open_viewer
from needleforce.scene.nodes import PlanScene
from needleforce.scene.slicer import SlicerOutput
from needleforce.scene.state_ring import StateRing, view_row
from needleforce.scene.viewer import SceneError, Viewer

__all__ = [
    "LiveView",
    "PlanScene",
    "SceneError",
    "SlicerOutput",
    "StateRing",
    "Viewer",
    "open_viewer",
    "view_row",
]
