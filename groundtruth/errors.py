"""Errors of the ground truth: one base, each leaf also a builtin, so that both can be caught."""


class GroundTruthError(Exception):
    """Base of every error this package raises on purpose."""


class TissueError(GroundTruthError, ValueError):
    """A layer, membrane or friction that no tissue can have, or an unusable sample for a law."""


class MotionError(GroundTruthError, ValueError):
    """A motion that cannot be carried out: no travel, no speed, no way back above the surface."""


class ScenarioError(GroundTruthError, LookupError):
    """An unknown scenario or tissue law; the message lists the known ones."""


class NoiseError(GroundTruthError, ValueError):
    """A noise model with a negative or non-finite figure."""


class RunError(GroundTruthError, ValueError):
    """A simulation asked for with settings it cannot use (rate, sub-steps, traces)."""


class ArmLevelError(GroundTruthError, ValueError):
    """An unknown arm level, or link tables that cannot be blended."""


class PathError(GroundTruthError, ValueError):
    """A straight line that the arm cannot follow with its needle."""


class PlantError(GroundTruthError, RuntimeError):
    """The simulated arm cannot run, or has left the motion it was told to follow."""
