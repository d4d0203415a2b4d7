"""What a session tells about a tick, and all that it remembers."""

from typing import NamedTuple

from identification import Estimate
from identification import Snapshot as IdentifierSnapshot
from insertion.tip_travel import Travel, TravelZero
from residual import Caution, Status, WrenchEstimate
from residual.sensor_state import SensorState


class SessionEstimate(NamedTuple):
    """State of knowledge after one tick. Every number is finite.

    Attributes:
        wrench: Force on the needle, see `WrenchEstimate`.
        depth_m: Travel of the tip along the needle since the tare or `begin_insertion`.
        speed_m_s: Its rate.
        identification: Layers, friction, tip force; that of the last tick that was fed to the
            identifier, its ``rupture``, ``compensated`` and ``withdrawn`` only in the tick that
            brought them.
        status: Whether the numbers are of this tick and tared.
        is_fed: Whether this tick's force went into the identification.
    """

    wrench: WrenchEstimate
    depth_m: float
    speed_m_s: float
    identification: Estimate
    status: Status
    is_fed: bool

    @property
    def cautions(self) -> Caution:
        """What may be wrong with the force beyond its standard deviation."""
        return self.wrench.cautions


class SessionSnapshot(NamedTuple):
    """All that an `InsertionSession` remembers; immutable.

    Attributes:
        sensor: Of the virtual sensor.
        identifier: Of the identifier.
        zero: Where depth is counted from.
        travel: Last depth and speed.
        speed_lag_s: Setting of the session.
        unfed_s: Time of samples taken by the sensor that the identifier has not seen [s].
    """

    sensor: SensorState
    identifier: IdentifierSnapshot
    zero: TravelZero
    travel: Travel
    speed_lag_s: float
    unfed_s: float
