"""What messages about a refused tare advise."""

from foundation.advice import Advice


class TareAdvice(Advice):
    """What to do about a tare that was refused, in words of `VirtualForceSensor`."""

    COMPENSATE_GRAVITY = "set torque_is_gravity_compensated=True"
    KEEP_GRAVITY = "set torque_is_gravity_compensated=False"
    NEGATE_TORQUE = "negate it"
    SEND_MEASURED_TORQUE = "call update() instead"
    SEND_NEGATED_TORQUE = "negate it and call update() instead"
    MOVE_FREELY = (
        "update() the sensor without contact first, in steps no longer than "
        "max_gap_s, then tare()"
    )
    IGNORE_CONTACT = ", or ignore_contact=True if you know better"
