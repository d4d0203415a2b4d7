"""The insertion in a browser page, live or recorded, and in 3D Slicer.

Reading order: `state_ring` (what a loop hands over), `nodes` (what stands in the
scene), `viewer` (the page) with its parts `title_bar`, `time_panel`, `force_plots`,
`structure_list`, `scan_slices`, `force_arrow` and `row_text` (a row in words);
`guarded_server` (who may open the page), `live` (the page beside a loop), `slicer`
(OpenIGTLink).
"""

from needleforce.scene.live import LiveView as LiveView, open_viewer as open_viewer
from needleforce.scene.nodes import PlanScene as PlanScene
from needleforce.scene.slicer import SlicerOutput as SlicerOutput
from needleforce.scene.state_ring import (
    SceneError as SceneError,
    StateRing as StateRing,
    view_row as view_row,
)
from needleforce.scene.viewer import Viewer as Viewer
