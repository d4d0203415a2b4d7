"""What messages about a robot that cannot be loaded advise."""

from foundation.advice import Advice


class RobotAdvice(Advice):
    """What to do about a robot that cannot be loaded, in words of `urdf`."""

    LOCK_JOINT = "lock it with locked_joints"
    LOAD_FILE = "load_urdf(FILE) loads any other"
