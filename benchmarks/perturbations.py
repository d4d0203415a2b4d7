"""Every departure from the assumptions that the robustness benchmark tries: what, how much, why.

A world is a scenario and a plant. A perturbation changes one thing in it; its size is drawn anew
for every seed, so that nothing can be tuned to one value. Those whose size has no source say that
it is chosen.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from groundtruth import PLANT_MODELS, PlantModel, Scenario
from groundtruth.disturbances import ElbowPush, LateralForce, TissueMotion
from groundtruth.motion import Motion, Move, protocol
from groundtruth.variations import TissueVariation, random_variation

Draw = np.random.Generator


@dataclass(frozen=True, slots=True, kw_only=True)
class World:
    """What is simulated: the plant says what the sensors add, for the needle alone as well."""

    scenario: Scenario
    plant: PlantModel = PLANT_MODELS["clean"]
    has_speed: bool = True  # whether who reads the F/T sensor has a speed besides the depth


class Perturbation(NamedTuple):
    """One departure; a new one is one more entry below."""

    what: str  # for people, with the range of its size
    source: str  # of the size; "chosen" where there is none
    change: Callable[[World, Draw], World]


def _plant(**ranges: tuple[float, float] | float | None) -> Callable[[World, Draw], World]:
    """Change numbers of the plant; a pair is a range, drawn with equal chance per octave."""

    def change(world: World, rng: Draw) -> World:
        drawn = {n: log_uniform(rng, *r) if isinstance(r, tuple) else r for n, r in ranges.items()}
        return _with_plant(world, **drawn)

    return change


def _with_plant(world: World, **numbers: Any) -> World:
    return replace(world, plant=replace(world.plant, **numbers))


def log_uniform(rng: Draw, low: float, high: float) -> float:
    """Equal chance per octave."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _named(plant: str) -> Callable[[World, Draw], World]:
    return lambda world, _: replace(world, plant=PLANT_MODELS[plant])


def _ft_noise(correlation_s: tuple[float, float] | None) -> Callable[[World, Draw], World]:
    """All axes of the F/T sensor as much noisier as its z axis, which has 10 mN."""

    def change(world: World, rng: Draw) -> World:
        factor = log_uniform(rng, 10e-3, 60e-3) / world.plant.ft_noise_std[2]
        lag = 0.0 if correlation_s is None else log_uniform(rng, *correlation_s)
        noise = tuple(factor * std for std in world.plant.ft_noise_std)
        return _with_plant(world, ft_noise_std=noise, ft_noise_correlation_s=lag)

    return change


def _noisier_torque(world: World, rng: Draw) -> World:
    factor = log_uniform(rng, 2.0, 4.0)
    noise = tuple(factor * std for std in world.plant.torque_noise_std_Nm)
    return _with_plant(world, torque_noise_std_Nm=noise)


def _viscous_bearings(world: World, rng: Draw) -> World:
    return _with_plant(world, joint_viscous_Nms_per_rad=tuple(rng.uniform(0.19, 0.84, 7).tolist()))


def _depth_only(world: World, rng: Draw) -> World:
    noise = log_uniform(rng, 2e-5, 1.75e-4)
    without = _with_plant(world, position_noise_std_rad=noise, velocity_noise_std_rad_s=None)
    return replace(without, has_speed=False)


def _slower_interface(world: World, rng: Draw) -> World:
    return _with_plant(world, ticks_per_sample=int(rng.integers(2, 6)))


# Motion of the tissue, of the needle, of other hands.


def _waves(amplitude_m: float, frequency_hz: float, rng: Draw) -> list[tuple[float, float, float]]:
    """A wave with a second harmonic of up to half its size: no organ moves as a pure sine."""
    phases = rng.uniform(0.0, 2.0 * np.pi, 2)
    second = rng.uniform(0.0, 0.5) * amplitude_m
    return [
        (amplitude_m, frequency_hz, float(phases[0])),
        (float(second), 2.0 * frequency_hz, float(phases[1])),
    ]


def _organ(*, heart: bool = False, breath: bool = False) -> Callable[[World, Draw], World]:
    def change(world: World, rng: Draw) -> World:
        waves: list[tuple[float, float, float]] = []
        if heart:
            waves += _waves(log_uniform(rng, 0.1e-3, 0.3e-3), rng.uniform(1.0, 1.6), rng)
        if breath:
            waves += _waves(log_uniform(rng, 0.5e-3, 2e-3), rng.uniform(0.2, 0.3), rng)
        motion = TissueMotion(waves=tuple(waves))
        return replace(world, scenario=replace(world.scenario, tissue_motion=motion))

    return change


def _moving(motion: Callable[[Motion, Draw], list[Move]]) -> Callable[[World, Draw], World]:
    """Other strokes of the insertion; they travel as far."""

    def change(world: World, rng: Draw) -> World:
        old, moves = world.scenario.motion, motion(world.scenario.motion, rng)
        return _with_motion(world, protocol(-old.strokes[3].end_m, moves, ramp_fraction=0.1))

    return change


def _with_motion(world: World, motion: Motion) -> World:
    return replace(world, scenario=replace(world.scenario, motion=motion))


def _at_speed(low_m_s: float, high_m_s: float) -> Callable[[Motion, Draw], list[Move]]:
    def moves(motion: Motion, rng: Draw) -> list[Move]:
        travel_m = motion.deepest_m - motion.strokes[3].end_m
        return [("cruise", travel_m / log_uniform(rng, low_m_s, high_m_s), travel_m)]

    return moves


def _in_steps(back_m: tuple[float, float]) -> Callable[[Motion, Draw], list[Move]]:
    """Pieces of 5 to 15 mm; after each a rest of 0.3 to 3 s, and perhaps a little back."""

    def moves(motion: Motion, rng: Draw) -> list[Move]:
        total_m = motion.deepest_m - motion.strokes[3].end_m
        speed_m_s = total_m / motion.strokes[4].duration_s
        found: list[Move] = []
        place_m = reached_m = 0.0
        while total_m - reached_m > 20e-3:
            reached_m += float(rng.uniform(5e-3, 15e-3))
            travel_m, back = reached_m - place_m, float(rng.uniform(*back_m))
            found.append(("cruise", travel_m / speed_m_s, travel_m))
            found.append(("rest", float(rng.uniform(0.3, 3.0)), 0.0))
            if back > 0.0:
                found.append(("cruise", back / speed_m_s, -back))
            place_m = reached_m - back
        last_m = total_m - place_m
        found.append(("cruise", last_m / speed_m_s, last_m))
        return found

    return moves


def _tare_stroke(low_m: float, high_m: float) -> Callable[[World, Draw], World]:
    def change(world: World, rng: Draw) -> World:
        motion, stroke_m = world.scenario.motion, float(rng.uniform(low_m, high_m))
        inside = [s for s in motion.strokes[4:] if s.start_s < motion.insertion_end_s - 1e-6]
        moves: list[Move] = [(s.profile, s.duration_s, s.travel_m) for s in inside]
        start_m, ramp = -inside[0].start_m, inside[0].ramp_fraction
        again = protocol(start_m, moves, ramp_fraction=ramp, tare_stroke_m=stroke_m)
        return _with_motion(world, again)

    return change


def _lateral(kind: str) -> Callable[[World, Draw], World]:
    def change(world: World, rng: Draw) -> World:
        size_N, side = rng.uniform(0.2, 0.4), rng.uniform(0.0, 2.0 * np.pi)
        force = LateralForce(constant_N=size_N, direction_rad=side)
        if kind == "growing":
            force = LateralForce(growth_N_per_m=size_N / 0.1, direction_rad=side)
        elif kind == "turning":
            force = replace(force, turn_rad_per_m=float(rng.uniform(0.5, 1.0) * np.pi / 0.05))
        return replace(world, scenario=replace(world.scenario, lateral=force))

    return change


def _elbow(world: World, rng: Draw) -> World:
    motion = world.scenario.motion
    start_s = [motion.tare_end_s + rng.uniform(2.0, 6.0)]
    while start_s[-1] < motion.withdrawal_end_s:
        start_s.append(start_s[-1] + rng.uniform(4.0, 12.0))
    side = rng.standard_normal(3)
    side *= rng.uniform(1.5, 3.0) / np.linalg.norm(side)
    push = ElbowPush(
        force_N=tuple(side.tolist()),
        start_s=tuple(start_s),
        duration_s=float(rng.uniform(0.5, 2.0)),
    )
    return replace(world, scenario=replace(world.scenario, elbow=push))


def _tissue(**ranges: tuple[float, float]) -> Callable[[World, Draw], World]:
    """Every layer under one variation, see `TissueVariation`."""

    def change(world: World, rng: Draw) -> World:
        variation = TissueVariation(**{n: float(rng.uniform(*r)) for n, r in ranges.items()})
        return replace(world, scenario=world.scenario.with_variation(variation, rng))

    return change


def _own_laws(world: World, rng: Draw) -> World:
    layers = tuple(random_variation(rng).layer(layer, rng) for layer in world.scenario.layers)
    return replace(world, scenario=replace(world.scenario, layers=layers))


_CHOSEN = "chosen"
_EARLIER = "chosen; breaks earlier versions"
_LIVER = "19 insertions into real liver (de Jong 2017)"
_BARNETT = "Barnett, Lee, Moore 2015"

_ON_THE_ARM: dict[str, dict[str, Perturbation]] = {
    "pushes": {
        "lateral": Perturbation("lateral force, 0.2 to 0.4 N", _EARLIER, _lateral("constant")),
        "lateral-growing": Perturbation(
            "lateral force growing to 0.2 to 0.4 N at 100 mm", _EARLIER, _lateral("growing")
        ),
        "lateral-turning": Perturbation(
            "lateral force, 0.2 to 0.4 N, turning by 90 to 180 degrees in 50 mm",
            _CHOSEN,
            _lateral("turning"),
        ),
        "elbow": Perturbation("1.5 to 3 N at the elbow, every 4 to 12 s", _EARLIER, _elbow),
    },
    "torque": {
        "friction": Perturbation(
            "link-side Coulomb friction, 0.02 to 0.1 Nm at J3 to J5",
            "0.02 Nm give the published errors of the real arm, see docs/plants.md",
            _plant(joint_coulomb=(2e-4, 1e-3)),
        ),
        "friction-x3": Perturbation(
            "the same, three times larger", _CHOSEN, _plant(joint_coulomb=(6e-4, 3e-3))
        ),
        "friction-viscous": Perturbation(
            "link-side viscous friction, 0.19 to 0.84 Nms/rad",
            "fact sheet of the LWR 4+",
            _viscous_bearings,
        ),
        "hysteresis": Perturbation(
            "torque hysteresis, 4e-4 to 6e-4 of the limit",
            "five times that of the plant degraded",
            _plant(torque_hysteresis=(4e-4, 6e-4)),
        ),
        "hysteresis-x5": Perturbation(
            "the same, five times larger",
            "half of the 0.5 % linearity in the data sheet",
            _plant(torque_hysteresis=(2e-3, 3e-3)),
        ),
        "walk": Perturbation(
            "random walk of torque, 2e-4 to 4e-4 of the limit in a minute",
            "ten times that of the plant clean",
            _plant(torque_random_walk_std_per_sqrt_min=(2e-4, 4e-4)),
        ),
        "drift": Perturbation(
            "linear drift of torque, 7e-4 to 1.4e-3 of the limit per minute",
            "ten times that of the plant clean",
            _plant(torque_drift_std_per_min=(7e-4, 1.4e-3)),
        ),
        "warm-up": Perturbation(
            "zero of torque fading by 5e-4 to 1.5e-3 of the limit in 30 to 90 s",
            _EARLIER,
            _plant(torque_warm_up=(5e-4, 1.5e-3), warm_up_s=(30.0, 90.0)),
        ),
        "torque-colour": Perturbation(
            "torque noise behind a low-pass of 6 to 30 Hz",
            "data sheet: its figure holds behind 8 Hz",
            _plant(torque_noise_correlation_s=(5e-3, 25e-3)),
        ),
        "torque-noise": Perturbation("torque noise x 2 to 4", _EARLIER, _noisier_torque),
    },
    "tare": {
        "tare-short": Perturbation(
            "tare strokes of 15 to 25 mm", _EARLIER, _tare_stroke(15e-3, 25e-3)
        ),
        "tare-at-rest": Perturbation("tare at rest", _EARLIER, _tare_stroke(0.0, 0.0)),
    },
}
_ON_BOTH: dict[str, dict[str, Perturbation]] = {
    "interface": {
        "position": Perturbation(
            "position noise, 2e-5 to 1.75e-4 rad",
            "encoders on the motor and on the link",
            _plant(position_noise_std_rad=(2e-5, 1.75e-4)),
        ),
        "position-only": Perturbation(
            "the same, no velocity sent",
            "the research interface sends none",
            _plant(position_noise_std_rad=(2e-5, 1.75e-4), velocity_noise_std_rad_s=None),
        ),
        "depth-only": Perturbation(
            "the same, and with the F/T sensor no speed at all",
            "logs of depth and force",
            _depth_only,
        ),
        "velocity": Perturbation(
            "velocity noise, 4e-4 to 2e-3 rad/s",
            "two to ten times that of the plant clean",
            _plant(velocity_noise_std_rad_s=(4e-4, 2e-3)),
        ),
        "rate": Perturbation("200 to 500 Hz", "rates of robot interfaces", _slower_interface),
    },
    "F/T": {
        "force-noise": Perturbation(
            "white F/T noise, 10 to 60 mN", "raw samples of an ATI Mini45: 50 mN", _ft_noise(None)
        ),
        "force-colour": Perturbation(
            "the same behind a low-pass of 6 to 30 Hz",
            "means of a Mini45 over 0.1 s still scatter by 16 mN",
            _ft_noise((5e-3, 25e-3)),
        ),
    },
    "organ": {
        "heartbeat": Perturbation(
            "tissue moves by 0.1 to 0.3 mm at 1 to 1.6 Hz", _CHOSEN, _organ(heart=True)
        ),
        "breathing": Perturbation(
            "tissue moves by 0.5 to 2 mm at 0.2 to 0.3 Hz", _CHOSEN, _organ(breath=True)
        ),
        "heart-and-breath": Perturbation("both", _CHOSEN, _organ(heart=True, breath=True)),
    },
    "motion": {
        "stop-and-go": Perturbation(
            "rests of 0.3 to 3 s every 5 to 15 mm", _CHOSEN, _moving(_in_steps((0.0, 0.0)))
        ),
        "reversals": Perturbation(
            "the same, and 1 to 4 mm back", _CHOSEN, _moving(_in_steps((1e-3, 4e-3)))
        ),
        "slow": Perturbation("0.5 to 1 mm/s", _CHOSEN, _moving(_at_speed(0.5e-3, 1e-3))),
        "fast": Perturbation("10 to 20 mm/s", _CHOSEN, _moving(_at_speed(10e-3, 20e-3))),
    },
    "tissue": {
        "texture": Perturbation("texture, 15 to 20 mN", _LIVER, _tissue(texture_N=(15e-3, 20e-3))),
        "release": Perturbation("releases over 1 to 2 mm", _LIVER, _tissue(release_m=(1e-3, 2e-3))),
        "concave": Perturbation(
            "tip force with penetration^0.5 to ^0.7", _CHOSEN, _tissue(tip_exponent=(0.5, 0.7))
        ),
        "quadratic": Perturbation(
            "tip force with penetration^1.5 to ^2",
            "Okamura, Simone, O'Leary 2004",
            _tissue(tip_exponent=(1.5, 2.0)),
        ),
        "plateau": Perturbation(
            "60 to 80 % of the tip force are cutting",
            _BARNETT,
            _tissue(cutting_fraction=(0.6, 0.8)),
        ),
        "kept": Perturbation(
            "30 to 60 % of the tip force stay after internal ruptures",
            _CHOSEN,
            _tissue(kept_fraction=(0.3, 0.6)),
        ),
        "friction-length": Perturbation(
            "friction with length^0.6 to ^0.8", _LIVER, _tissue(length_exponent=(0.6, 0.8))
        ),
        "friction-speed": Perturbation(
            "friction with speed^0.25 to ^0.43", "Table I", _tissue(speed_exponent=(0.25, 0.43))
        ),
        "friction-low": Perturbation(
            "20 to 30 % of the force are friction", _BARNETT, _tissue(friction_fraction=(0.2, 0.3))
        ),
        "friction-high": Perturbation(
            "65 to 75 % of the force are friction", _LIVER, _tissue(friction_fraction=(0.65, 0.75))
        ),
        "own-laws": Perturbation("every layer under a law of its own", "all of these", _own_laws),
    },
}
_PLANTS = {
    "none": Perturbation("nothing", "", lambda world, _: world),
    "fri": Perturbation("the plant fri", "docs/plants.md", _named("fri")),
    "degraded": Perturbation("the plant degraded", "docs/plants.md", _named("degraded")),
}
GROUPS: Mapping[str, Mapping[str, Perturbation]] = MappingProxyType(_ON_THE_ARM | _ON_BOTH)
"""What `mixed` draws from: at most one of a group, since those of one group change the same."""
ARM_ONLY = frozenset(name for group in _ON_THE_ARM.values() for name in group)
"""Of these the needle without an arm feels nothing."""
PERTURBATIONS: Mapping[str, Perturbation] = MappingProxyType(
    _PLANTS | {name: each for group in GROUPS.values() for name, each in group.items()}
)
"""By name, in the order of the table."""
MIXED, MIXED_COUNT = "mixed", 3


def perturbed(name: str, scenario: Scenario, seed: int) -> tuple[World, tuple[str, ...]]:
    """A scenario in a perturbed world, and the perturbations: of `mixed`, those that were drawn.

    Equal arguments give equal worlds; estimators must be tuned on seeds below 1000, and are
    reported on seeds from 1000 on.
    """
    rng = np.random.default_rng([seed, crc32(f"{name} {scenario.id}".encode())])
    names = (name,)
    if name == MIXED:
        groups = sorted(rng.choice(len(GROUPS), MIXED_COUNT, replace=False).tolist())
        drawn = (list(list(GROUPS.values())[k]) for k in groups)
        names = tuple(group[int(rng.integers(len(group)))] for group in drawn)
    world = World(scenario=scenario)
    # The tare last: other motions are built with the usual one.
    for each in sorted(names, key=lambda each: each.startswith("tare")):
        world = PERTURBATIONS[each].change(world, rng)
    return world, names
