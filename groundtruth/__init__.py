"""The simulated truth: arm, needle, tissue and sensors, which the estimators never see."""

from groundtruth.errors import GroundTruthError
from groundtruth.force_noise import ForceNoise
from groundtruth.layer import Layer
from groundtruth.motion import Motion
from groundtruth.needle_run import NeedleRun, insert_needle
from groundtruth.random_stack import random_stack
from groundtruth.rupture import Rupture
from groundtruth.scenario import Scenario
from groundtruth.scenarios import SCENARIOS, scenario
from groundtruth.tissue_force import TissueForce, TissueLaw

__all__ = [
    "SCENARIOS",
    "ForceNoise",
    "GroundTruthError",
    "Layer",
    "Motion",
    "NeedleRun",
    "Rupture",
    "Scenario",
    "TissueForce",
    "TissueLaw",
    "insert_needle",
    "random_stack",
    "scenario",
]
