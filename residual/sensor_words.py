"""What the virtual sensor tells its caller in words."""

SETTLING = "the filters have just started, or a time step was longer than max_gap_s"
NOT_TARED = "tare() has not been called"
STALE = (
    "since the tare a time step of minutes has come, a pause or a clock that was set; "
    "axial_std holds for a pause: withdraw and tare again"
)
OTHER_KIND = (
    "update() and update_external_torque() were mixed; a tare is of one kind of torque: keep to "
    "one of the two, or start_recording() first"
)
