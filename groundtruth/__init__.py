"""The simulated ground truth: arm, needle, tissue and sensors.

The estimators never see it.

There are two simulations of one scenario: `insert_needle` moves the needle by itself,
in half a second; `simulate` has the arm move it, in MuJoCo, and reports what the arm's
sensors read. In closed loop `rig_arm.SimulatedArm` takes joint velocities, one sample
at a time.

Reading order: `scenarios` (what is simulated), `tissue` (the laws), `materials` and
`plant_model` (every number and its source), `simulation` (both simulations and their
results), then `arm_plant` and `arm_control`; for the closed loop `rig_arm`,
`rig_contacts`, `rig_operator`.
"""

from groundtruth.errors import GroundTruthError
from groundtruth.layers import Layer
from groundtruth.motion import Motion
from groundtruth.plant_model import PLANT_MODELS, ForceNoise, PlantModel
from groundtruth.scenarios import SCENARIOS, Scenario, random_stack, scenario
from groundtruth.simulation import (
    NeedleRun,
    Run,
    Signals,
    Truth,
    insert_needle,
    simulate,
)
from groundtruth.tissue import Rupture, Tissue, TissueForce

__all__ = [
    "PLANT_MODELS",
    "SCENARIOS",
    "ForceNoise",
    "GroundTruthError",
    "Layer",
    "Motion",
    "NeedleRun",
    "PlantModel",
    "Run",
    "Rupture",
    "Scenario",
    "Signals",
    "Tissue",
    "TissueForce",
    "Truth",
    "insert_needle",
    "random_stack",
    "scenario",
    "simulate",
]
