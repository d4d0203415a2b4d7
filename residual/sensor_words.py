"""What the virtual sensor tells its caller in words."""

from residual.wrench_estimate import Caution

SETTLING = "the filters have just started, or a time step was longer than max_gap_s"
NOT_TARED = "tare() has not been called"
STALE = (
    "since the tare a time step of minutes has come, a pause or a clock that was set; "
    "axial_std holds for a pause: withdraw and tare again"
)
FORGOTTEN = (
    "a time step of minutes has come while free motion was recorded, a pause or a clock that was "
    "set; what was recorded before it is forgotten: move in free air again, then tare"
)
OTHER_KIND = (
    "update() and update_external_torque() were mixed; a tare is of one kind of torque: keep to "
    "one of the two, or start_recording() first"
)


def with_warnings(cautions: Caution, message: str, frozen: str, stale: str) -> tuple[Caution, str]:
    """Cautions and message with what else is to be warned of.

    Args:
        cautions: So far.
        message: So far.
        frozen: What seems frozen, in words; empty if nothing does.
        stale: What has become of the tare, in words; empty if nothing has.
    """
    if frozen:
        cautions |= Caution.FROZEN
    if stale:
        cautions |= Caution.STALE
    return cautions, "; ".join(filter(None, (frozen, stale, message)))
