"""Any scenario by what it is called on a command line, drawn ones included."""

import numpy as np

from groundtruth.errors import ScenarioError
from groundtruth.random_stack import RANDOM_STACK, random_stack
from groundtruth.scenario import Scenario
from groundtruth.scenarios import SCENARIOS


def named_scenario(name: str, seed: int) -> Scenario:
    """A catalogued scenario, or one drawn from the seed for the name ``random-stack``.

    Args:
        name: Of the scenario.
        seed: Of what is drawn.

    Raises:
        ScenarioError: There is none of that name; the message lists the names.
    """
    if name == RANDOM_STACK:
        return random_stack(np.random.default_rng(seed))
    if name not in SCENARIOS:
        known = ", ".join((*SCENARIOS, RANDOM_STACK))
        raise ScenarioError(f"no scenario {name!r}; known: {known}")
    return SCENARIOS[name]
