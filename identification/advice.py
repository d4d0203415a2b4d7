"""What messages about a recording with a wrong sign advise."""

from foundation.advice import Advice


class SignAdvice(Advice):
    """What to do about a column that seems to have the wrong sign."""

    FLIP_FORCE = "flip its sign"
    FLIP_DEPTH = "flip its sign?"
    FLIP_SPEED = "flip one of them"
