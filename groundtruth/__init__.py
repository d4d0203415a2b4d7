"""The simulated truth: arm, needle, tissue and sensors, which the estimators never see."""

from groundtruth.errors import GroundTruthError
from groundtruth.layer import Layer
from groundtruth.membrane import Membrane
from groundtruth.scenario import Scenario
from groundtruth.scenarios import SCENARIOS, scenario
from groundtruth.textbook_tissue import TextbookTissue
from groundtruth.tissue import Tissue
from groundtruth.tissue_force import TissueForce

__all__ = [
    "SCENARIOS",
    "GroundTruthError",
    "Layer",
    "Membrane",
    "Scenario",
    "TextbookTissue",
    "Tissue",
    "TissueForce",
    "scenario",
]
