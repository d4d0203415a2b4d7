"""Online identification of needle-tissue interaction; knows nothing of robots.

From depth, speed and axial force: ruptures as they happen, stiffness and friction of each layer,
the enhanced force without the friction of the layers traversed, and the force at the tip.

    identifier = Identifier()                       # or Identifier(PAPER)
    estimate = identifier.update(depth_m, speed_m_s, force_N, dt_s)

Reading order: `identifier`; the published method in `published_update` (every sample) and
`published_step` (the rest), one file per further equation; ours in `multilayer_update`,
`multilayer_step`, `slope_change_detector`, `rupture_fit`, `layer_model`; known layers in `offline`.
"""

from identification.errors import IdentificationError
from identification.estimate import Estimate, LayerEstimate, Rupture, RuptureState
from identification.identifier import Identifier, Snapshot
from identification.input_validation import SampleStatus
from identification.interaction_model import LayerSpan
from identification.log_replay import Replay, replay
from identification.multilayer_config import MULTILAYER, MultilayerConfig
from identification.offline import OfflineIdentification, OfflineLayer, identify_offline
from identification.published_config import PUBLISHED, PUBLISHED_KV, PublishedConfig

__all__ = [
    "MULTILAYER",
    "PUBLISHED",
    "PUBLISHED_KV",
    "Estimate",
    "IdentificationError",
    "Identifier",
    "LayerEstimate",
    "LayerSpan",
    "MultilayerConfig",
    "OfflineIdentification",
    "OfflineLayer",
    "PublishedConfig",
    "Replay",
    "Rupture",
    "RuptureState",
    "SampleStatus",
    "Snapshot",
    "identify_offline",
    "replay",
]
