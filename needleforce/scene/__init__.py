"""The insertion in a browser page, live or recorded, and in 3D Slicer.

Reading order: `moment` (what a loop hands over), `words` (a moment in words), `nodes`
(what stands in the scene), `viewer` (the page) with its parts `insertion_card`,
`scan_slices` and `force_plots`; `export_page` (one file), `live` (the page beside a
loop), `slicer` (OpenIGTLink).
"""

from needleforce.scene.export_page import export_plan as export_plan
from needleforce.scene.live import LiveView as LiveView, open_viewer as open_viewer
from needleforce.scene.moment import (
    Moment as Moment,
    SceneError as SceneError,
    is_kept as is_kept,
)
from needleforce.scene.nodes import PlanScene as PlanScene
from needleforce.scene.slicer import SlicerOutput as SlicerOutput
from needleforce.scene.viewer import Viewer as Viewer
