"""Perturbed worlds: one thing is not as the estimators assume.

A world is a scenario and a plant. `perturbations.toml` defines them: what is changed,
within which range, and why. Its fields are those of `Perturbation`.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from zlib import crc32

import msgspec
import numpy as np

from groundtruth import PLANT_MODELS, Motion, PlantModel, Scenario
from groundtruth.motion import Move, Tremor, protocol
from groundtruth.scenarios import ElbowPush, LateralForce, TissueMotion, Wave
from groundtruth.variations import TissueVariation, random_variation

Rng = np.random.Generator
Range = tuple[float, float]


class _Wave(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One wave of the tissue's motion."""

    amplitude_m: Range
    frequency_hz: Range


class _Steps(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Pieces of an insertion.

    Attributes:
        every_m: Travel of a piece.
        rest_s: Rest after each.
        back_m: Pulled back after the rest.
    """

    every_m: Range
    rest_s: Range
    back_m: Range = (0.0, 0.0)


class _Elbow(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Pushes at the elbow.

    Attributes:
        force_N: In any direction.
        every_s: From one push to the next.
        duration_s: Of a push.
    """

    force_N: Range
    every_s: Range
    duration_s: Range


class Perturbation(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True
):
    """One departure; of what is not given, nothing is changed.

    Attributes:
        what: For people.
        source: Of the size.
        base: The plant, by name.
        plant: Numbers of the plant; of joint-wise ones, each is drawn.
        times: Factors on joint-wise numbers of the plant.
        sends_velocity: Whether the robot sends velocities.
        has_speed: Whether who reads the F/T sensor has a speed beside the depth.
        tare_stroke_m: zero: at rest.
        speed_m_s: Constant speed of the insertion.
        steps: Pieces of the insertion.
        tremor: Numbers of a `Tremor` of the hand that holds the needle.
        waves: Motion of the tissue.
        tissue: Numbers of a `TissueVariation`, of every layer.
        own_laws: A random variation for every layer.
        lateral: Numbers of a `LateralForce`.
        elbow: Pushes of a hand.
    """

    what: str
    source: str
    base: str = ""
    plant: dict[str, Range] = {}
    times: dict[str, Range] = {}
    sends_velocity: bool = True
    has_speed: bool = True
    tare_stroke_m: Range | None = None
    speed_m_s: Range | None = None
    steps: _Steps | None = None
    tremor: dict[str, Range] = {}
    waves: tuple[_Wave, ...] = ()
    tissue: dict[str, Range] = {}
    own_laws: bool = False
    lateral: dict[str, Range] = {}
    elbow: _Elbow | None = None

    def __call__(self, world: "World", rng: Rng) -> "World":
        """Return the world with this changed, its size drawn."""
        plant = PLANT_MODELS[self.base] if self.base else world.plant
        numbers: dict[str, Any] = {
            name: _like(getattr(plant, name), limits, rng)
            for name, limits in self.plant.items()
        }
        for name, limits in self.times.items():
            factor = drawn(limits, rng)
            numbers[name] = tuple(factor * number for number in getattr(plant, name))
        if not self.sends_velocity:
            numbers["velocity_noise_std_rad_s"] = None
        return World(
            scenario=self._scenario(world.scenario, rng),
            plant=replace(plant, **numbers),
            has_speed=world.has_speed and self.has_speed,
        )

    def _scenario(self, scenario: Scenario, rng: Rng) -> Scenario:
        """Return the scenario with what this perturbation changes of it."""
        motion = self._motion(scenario.motion, rng)
        if self.tremor:
            motion = replace(motion, tremor=Tremor(**_drawn_each(self.tremor, rng)))
        scenario = replace(scenario, motion=motion)
        if self.waves:
            scenario = replace(scenario, tissue_motion=_tissue_motion(self.waves, rng))
        if self.tissue:
            variation = TissueVariation(**_drawn_each(self.tissue, rng))
            scenario = scenario.with_variation(variation, rng)
        if self.own_laws:
            layers = tuple(
                random_variation(rng).layer(layer, rng) for layer in scenario.layers
            )
            scenario = replace(scenario, layers=layers)
        if self.lateral:
            numbers = _drawn_each(self.lateral, rng)
            numbers["direction_rad"] = float(rng.uniform(0.0, 2.0 * np.pi))
            scenario = replace(scenario, lateral=LateralForce(**numbers))
        if self.elbow is not None:
            scenario = replace(scenario, elbow=_pushes(self.elbow, motion, rng))
        return scenario

    def _motion(self, motion: Motion, rng: Rng) -> Motion:
        """Return the protocol with another insertion, or another tare."""
        if not (self.speed_m_s or self.steps or self.tare_stroke_m):
            return motion
        standoff_m = -motion.strokes[3].end_m
        stroke_m = motion.strokes[1].travel_m
        inside = [
            s for s in motion.strokes[4:] if s.end_s < motion.withdrawal_start_s - 1e-6
        ]
        moves = [Move(s.profile, s.duration_s, s.travel_m) for s in inside]
        ramp = inside[0].ramp_fraction
        travel_m = inside[-1].end_m + standoff_m
        if self.speed_m_s is not None:
            ramp = 0.05
            moves = [Move("cruise", travel_m / drawn(self.speed_m_s, rng), travel_m)]
        if self.steps is not None:
            speed_m_s = travel_m / sum(move.duration_s for move in moves)
            ramp = 0.1
            moves = list(_pieces(self.steps, travel_m, speed_m_s, rng))
        if self.tare_stroke_m is not None:
            stroke_m = drawn(self.tare_stroke_m, rng)
        return protocol(standoff_m, moves, ramp_fraction=ramp, tare_stroke_m=stroke_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class World:
    """What is simulated: a scenario on a plant.

    What the plant's sensors add holds for the needle alone as well.

    Attributes:
        scenario: The insertion.
        plant: The arm and its sensors.
        has_speed: Whether who reads the F/T sensor has a speed beside the depth.
    """

    scenario: Scenario
    plant: PlantModel = PLANT_MODELS["clean"]
    has_speed: bool = True


def drawn(limits: Range, rng: Rng) -> float:
    """Draw a number of the range, with equal chance per octave.

    The ends may both be 0.
    """
    low, high = limits
    return (
        float(np.exp(rng.uniform(math.log(low), math.log(high)))) if high > 0.0 else 0.0
    )


def _drawn_each(ranges: Mapping[str, Range], rng: Rng) -> dict[str, float]:
    """Draw a number of each range, by name."""
    return {name: drawn(limits, rng) for name, limits in ranges.items()}


def _like(value: object, limits: Range, rng: Rng) -> object:
    """Draw a number of the kind of the one that it takes the place of."""
    if isinstance(value, tuple):
        return tuple(drawn(limits, rng) for _ in value)
    return round(drawn(limits, rng)) if isinstance(value, int) else drawn(limits, rng)


def _tissue_motion(waves: tuple[_Wave, ...], rng: Rng) -> TissueMotion:
    """Draw each wave with a second harmonic of up to half its size.

    No organ moves as a pure sine.
    """
    waves_drawn: list[Wave] = []
    for wave in waves:
        size_m = drawn(wave.amplitude_m, rng)
        frequency_hz = drawn(wave.frequency_hz, rng)
        phases = rng.uniform(0.0, 2.0 * np.pi, 2).tolist()
        second_m = float(rng.uniform(0.0, 0.5)) * size_m
        waves_drawn.append(Wave(size_m, frequency_hz, phases[0]))
        waves_drawn.append(Wave(second_m, 2.0 * frequency_hz, phases[1]))
    return TissueMotion(waves=tuple(waves_drawn))


def _pieces(
    steps: _Steps, total_m: float, speed_m_s: float, rng: Rng
) -> Iterator[Move]:
    """Yield the moves of an insertion with rests, and steps back."""
    place_m = reached_m = 0.0
    while total_m - reached_m > 20e-3:  # no rest where so little is left
        reached_m += drawn(steps.every_m, rng)
        travel_m = reached_m - place_m
        back_m = drawn(steps.back_m, rng)
        yield Move("cruise", travel_m / speed_m_s, travel_m)
        yield Move("rest", drawn(steps.rest_s, rng), 0.0)
        if back_m > 0.0:
            yield Move("cruise", back_m / speed_m_s, -back_m)
        place_m = reached_m - back_m
    last_m = total_m - place_m
    yield Move("cruise", last_m / speed_m_s, last_m)


def _pushes(elbow: _Elbow, motion: Motion, rng: Rng) -> ElbowPush:
    """Draw the pushes of a hand during the insertion."""
    start_s = [motion.tare_end_s + drawn(elbow.every_s, rng)]
    while start_s[-1] < motion.withdrawal_end_s:
        start_s.append(start_s[-1] + drawn(elbow.every_s, rng))
    side = rng.standard_normal(3)
    x, y, z = (drawn(elbow.force_N, rng) / np.linalg.norm(side) * side).tolist()
    return ElbowPush(
        force_N=(x, y, z),
        start_s=tuple(start_s),
        duration_s=drawn(elbow.duration_s, rng),
    )


GROUPS: Mapping[str, Mapping[str, Perturbation]] = msgspec.toml.decode(
    Path(__file__).with_suffix(".toml").read_bytes(),
    type=dict[str, dict[str, Perturbation]],
)
"""As in the file."""
PERTURBATIONS: Mapping[str, Perturbation] = {
    name: each for group in GROUPS.values() for name, each in group.items()
}
"""By name, in the order of the table."""
FT_ONLY = frozenset((*GROUPS["F/T"], "depth-only", "stick-slip"))
"""Of these the virtual force feels nothing, or too little to be judged by it."""
MIXED = "mixed"
PERTURBED = "robustness-"
"""The names of benchmarks in perturbed worlds begin so."""


def perturbed(
    name: str, scenario: Scenario, seed: int
) -> tuple[World, tuple[str, ...]]:
    """Return a scenario in a perturbed world, and the names of the perturbations.

    Of `mixed` these are the ones that were drawn. Equal arguments give equal worlds;
    estimators are tuned on seeds below 1000, and reported on seeds from 1000 on.
    """
    rng = np.random.default_rng([seed, crc32(f"{name} {scenario.id}".encode())])
    names = (name,)
    if name == MIXED:
        groups = [
            list(group)
            for kind, group in GROUPS.items()
            if kind not in ("plants", "unmixed")
        ]
        chosen = sorted(rng.choice(len(groups), 3, replace=False).tolist())
        names = tuple(groups[k][int(rng.integers(len(groups[k])))] for k in chosen)
    world = World(scenario=scenario)
    for perturbation in names:
        world = PERTURBATIONS[perturbation](world, rng)
    return world, names
