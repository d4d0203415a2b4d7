"""The simulated truth: arm, needle, tissue and sensors, which the estimators never see."""

from groundtruth.arm_level import ARM_LEVELS, ArmLevel
from groundtruth.errors import GroundTruthError
from groundtruth.layer import Layer
from groundtruth.membrane import Membrane
from groundtruth.run import Run, Signals, Truth
from groundtruth.scenario import Scenario
from groundtruth.scenarios import SCENARIOS, scenario
from groundtruth.simulate import simulate
from groundtruth.textbook_tissue import TextbookTissue
from groundtruth.tissue import Tissue
from groundtruth.tissue_force import TissueForce

__all__ = [
    "ARM_LEVELS",
    "SCENARIOS",
    "ArmLevel",
    "GroundTruthError",
    "Layer",
    "Membrane",
    "Run",
    "Scenario",
    "Signals",
    "TextbookTissue",
    "Tissue",
    "TissueForce",
    "Truth",
    "scenario",
    "simulate",
]
