"""The catalogue of scenarios under their permanent names, after Sections II and VI of the paper."""

from collections.abc import Mapping
from types import MappingProxyType

from groundtruth.errors import ScenarioError
from groundtruth.layer import Layer
from groundtruth.materials import (
    GLOVE,
    TABLE_I_SPEED_M_S,
    abdominal_fat,
    abdominal_liver,
    abdominal_muscle,
    bovine_liver,
    gel,
)
from groundtruth.motion import Motion, constant_motion, free_motion, sinusoidal_motion
from groundtruth.scenario import Scenario

GLOVE_SPEED_M_S = 3e-3
"""The paper's speed for the stack with the glove."""
BEYOND_M = 12e-3
"""How far a constant-speed insertion goes beyond the last layer."""
CONSTANT_STANDOFF_M = 5e-3
"""Room to reach the constant speed before contact."""
SINE_STANDOFF_M = 20e-3
"""With A = 70 mm the 70 % gel then ruptures 20.7 s into the stroke; the paper says about 20 s."""
GEL_STROKE_M, GEL_FREQUENCY_HZ = 70e-3, 0.016
STACK_STROKE_M = 130e-3
"""The full gels are 98 mm together, more than the paper's 70 mm stroke crosses."""
ABDOMEN_STROKE_M, ABDOMEN_FREQUENCY_HZ = 115e-3, 0.02
ABDOMEN_STANDOFF_M = 22e-3


def _constant(layers: tuple[Layer, ...], speed_m_s: float) -> Motion:
    depth = sum(layer.thickness_m for layer in layers) + BEYOND_M
    return constant_motion(speed_m_s=speed_m_s, depth_m=depth, standoff_m=CONSTANT_STANDOFF_M)


def _sinusoidal(stroke_m: float, frequency_hz: float, standoff_m: float) -> Motion:
    return sinusoidal_motion(stroke_m=stroke_m, frequency_hz=frequency_hz, standoff_m=standoff_m)


def _gels() -> list[Scenario]:
    found: list[Scenario] = []
    for percent in (25, 50, 70):
        layers = (gel(percent),)
        sine = _sinusoidal(GEL_STROKE_M, GEL_FREQUENCY_HZ, SINE_STANDOFF_M)
        for kind, motion in (
            ("constant", _constant(layers, TABLE_I_SPEED_M_S)),
            ("sinusoidal", sine),
        ):
            found.append(
                Scenario(
                    id=f"gel-{percent}-{kind}",
                    title=f"one {percent} % isinglass gel, {kind} speed",
                    layers=layers,
                    motion=motion,
                )
            )
    return found


def _stacks() -> list[Scenario]:
    bare = (gel(25), gel(50), gel(70))
    gloved = (gel(25), gel(50, membrane=GLOVE), gel(70, membrane=GLOVE))
    sine = _sinusoidal(STACK_STROKE_M, GEL_FREQUENCY_HZ, SINE_STANDOFF_M)
    rows = (
        # 2.3 mm/s, not the glove's 3: the plateau is then the sum of Table I's products.
        ("stack-constant", "three gels, constant speed", bare, _constant(bare, TABLE_I_SPEED_M_S)),
        ("stack-sinusoidal", "three gels, sinusoidal speed", bare, sine),
        (
            "stack-glove-constant",
            "three gels, latex glove around the middle one, constant speed",
            gloved,
            _constant(gloved, GLOVE_SPEED_M_S),
        ),
        (
            "stack-glove-sinusoidal",
            "three gels, latex glove around the middle one, sinusoidal speed",
            gloved,
            sine,
        ),
    )
    return [Scenario(id=i, title=t, layers=layers, motion=m) for i, t, layers, m in rows]


def _organs() -> list[Scenario]:
    liver = (bovine_liver(),)
    return [
        Scenario(
            id="liver-constant",
            title="bovine liver, capsule first, constant speed",
            layers=liver,
            motion=_constant(liver, TABLE_I_SPEED_M_S),
        ),
        Scenario(
            id="abdomen-sinusoidal",
            title="abdominal phantom: fat, muscle, liver; sinusoidal speed",
            layers=(abdominal_fat(), abdominal_muscle(), abdominal_liver()),
            motion=_sinusoidal(ABDOMEN_STROKE_M, ABDOMEN_FREQUENCY_HZ, ABDOMEN_STANDOFF_M),
        ),
        Scenario(
            id="free-motion",
            title="no tissue",
            layers=(),
            motion=free_motion(height_m=20e-3, stroke_m=120e-3, frequency_hz=0.05),
        ),
    ]


SCENARIOS: Mapping[str, Scenario] = MappingProxyType(
    {item.id: item for item in (*_gels(), *_stacks(), *_organs())}
)
"""Every catalogued scenario under its permanent name."""


def scenario(scenario_id: str) -> Scenario:
    """The catalogued scenario of that name.

    Raises:
        ScenarioError: There is none; the message lists the names.
    """
    try:
        return SCENARIOS[scenario_id]
    except KeyError:
        known = ", ".join(SCENARIOS)
        raise ScenarioError(
            f"no scenario {scenario_id!r}; known: {known} (random ones: random_stack(rng))"
        ) from None
