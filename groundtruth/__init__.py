"""The simulated ground truth: arm, needle, tissue and sensors.

The estimators never see it.

There are two simulations of one scenario: `insert_needle` moves the needle by itself,
in half a second; `simulate` has the arm move it, in MuJoCo, and reports what the arm's
sensors read. In closed loop `SimulatedArm` takes joint velocities, one sample at a
time.

Reading order: `scenarios` (what is simulated), `tissue` (the laws), `materials` and
`plant_model` (every number and its source), `simulation` (both simulations and their
results), then `arm_plant` and `arm_control`; for the closed loop `rig_arm`,
`rig_contacts`, `rig_operator`.
"""

from groundtruth.errors import (
    GroundTruthError,
    MotionError,
    PlantError,
    PlantModelError,
    ScenarioError,
    TissueError,
)
from groundtruth.layers import Layer, Membrane, ShaftFriction, Texture
from groundtruth.materials import BOVINE_CAPSULE, BOVINE_LIVER, GLOVE, gel
from groundtruth.motion import (
    Motion,
    Move,
    Stroke,
    Tremor,
    chain_strokes,
    constant_motion,
    sinusoidal_motion,
)
from groundtruth.plant_model import PLANT_MODELS, ForceNoise, PlantModel, TICK_s
from groundtruth.rig_arm import ArmSample, ArmTruth, SimulatedArm
from groundtruth.rig_contacts import Contact, HandOnArm, PointMotion, Trocar, Wall
from groundtruth.rig_line import DelayLine
from groundtruth.rig_operator import HapticMaster, Operator, random_operator
from groundtruth.scenarios import (
    SCENARIOS,
    ElbowPush,
    LateralForce,
    Scenario,
    TissueMotion,
    Wave,
    random_stack,
    random_tissue,
    scenario,
)
from groundtruth.simulation import (
    NeedleRun,
    Run,
    Signals,
    Truth,
    insert_needle,
    simulate,
)
from groundtruth.tissue import Rupture, Tissue, TissueForce
from groundtruth.torso import Torso, analytic_torso
from groundtruth.variations import TissueVariation

__all__ = [
    "BOVINE_CAPSULE",
    "BOVINE_LIVER",
    "GLOVE",
    "PLANT_MODELS",
    "SCENARIOS",
    "ArmSample",
    "ArmTruth",
    "Contact",
    "DelayLine",
    "ElbowPush",
    "ForceNoise",
    "GroundTruthError",
    "HandOnArm",
    "HapticMaster",
    "LateralForce",
    "Layer",
    "Membrane",
    "Motion",
    "MotionError",
    "Move",
    "NeedleRun",
    "Operator",
    "PlantError",
    "PlantModel",
    "PlantModelError",
    "PointMotion",
    "Run",
    "Rupture",
    "Scenario",
    "ScenarioError",
    "ShaftFriction",
    "Signals",
    "SimulatedArm",
    "Stroke",
    "TICK_s",
    "Texture",
    "Tissue",
    "TissueError",
    "TissueForce",
    "TissueMotion",
    "TissueVariation",
    "Torso",
    "Tremor",
    "Trocar",
    "Truth",
    "Wall",
    "Wave",
    "analytic_torso",
    "chain_strokes",
    "constant_motion",
    "gel",
    "insert_needle",
    "random_operator",
    "random_stack",
    "random_tissue",
    "scenario",
    "simulate",
    "sinusoidal_motion",
]
