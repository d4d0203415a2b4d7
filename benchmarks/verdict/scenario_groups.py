"""Scenarios that are judged together, by name."""

from groundtruth import SCENARIOS
from groundtruth.random_stack import RANDOM_STACK

TISSUE = tuple(item.id for item in SCENARIOS.values() if item.layers)
GELS = tuple(name for name in TISSUE if name.startswith("gel-"))
"""Single gels, those of Table I."""
STACKS = tuple(name for name in TISSUE if name.startswith("stack-"))
RANDOM = (RANDOM_STACK,)
