"""Online identification of needle-tissue interaction; knows nothing of robots.

From depth, speed and axial force: ruptures as they happen, stiffness and friction of
each layer, the enhanced force without the friction of the layers traversed, and the
force at the tip.

    identifier = Identifier()                       # or Identifier(PUBLISHED)
    estimate = identifier.update(depth_m, speed_m_s, force_N, dt_s)

Reading order: `identifier`, `sample_check` (which samples are not used, such as those
with a NaN), `travel_filter`; the mixture of event hypotheses in the package `mixture`;
the published method, online and offline, in `published`; `channel` (a needle that comes
back to its channel).
"""

from foundation.errors import Suspicion
from identification.config import (
    MIXTURE,
    PUBLISHED,
    PUBLISHED_KV,
    CheckConfig,
    MixtureConfig,
    PublishedConfig,
)
from identification.errors import (
    IdentificationError,
    InvalidConfigError,
    InvalidLogError,
    InvalidSnapshotError,
)
from identification.estimate import (
    Estimate,
    HardContact,
    LayerEstimate,
    Rupture,
    RuptureState,
    SampleStatus,
    TissueWarning,
)
from identification.identifier import Identifier, Snapshot
from identification.log_replay import Replay, replay
from identification.published.offline import (
    LayerSpan,
    OfflineIdentification,
    OfflineLayer,
    identify_offline,
    regression_matrix,
)

__all__ = [
    "MIXTURE",
    "PUBLISHED",
    "PUBLISHED_KV",
    "CheckConfig",
    "Estimate",
    "HardContact",
    "IdentificationError",
    "Identifier",
    "InvalidConfigError",
    "InvalidLogError",
    "InvalidSnapshotError",
    "LayerEstimate",
    "LayerSpan",
    "MixtureConfig",
    "OfflineIdentification",
    "OfflineLayer",
    "PublishedConfig",
    "Replay",
    "Rupture",
    "RuptureState",
    "SampleStatus",
    "Snapshot",
    "Suspicion",
    "TissueWarning",
    "identify_offline",
    "regression_matrix",
    "replay",
]
