"""How probable each component is, and how many ruptures it counts."""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import WrittenVector
from foundation.records import read_column
from identification.estimate import Rupture
from identification.mixture.mixture import MIN_BETWEEN_RUPTURES_MM, Mixture

MM_PER_M = 1e3
"""Millimetres per metre."""


class Evidence(NamedTuple):
    """The mixture, the probability of each component, and how many ruptures it counts.

    Attributes:
        mixture: Of n components.
        weights: Their probabilities, shape (n,).
        ruptures: Number of ruptures that each counts, shape (n,).
    """

    mixture: Mixture
    weights: WrittenVector
    ruptures: WrittenVector

    def weights_of(self, ruptures: int) -> WrittenVector:
        """Return the probabilities of components with so many ruptures, of others 0."""
        return np.where(self.ruptures == ruptures, self.weights, 0.0)


def weigh_evidence(mixture: Mixture, alarm: Rupture | None, reported: int) -> Evidence:
    """Return the evidence after the last of the alarms reported.

    A component whose last rupture lies clearly before the alarm's denies that one.

    Args:
        mixture: As it is now.
        alarm: The last one, None before the first.
        reported: Ruptures reported so far.
    """
    clearly_before_mm = -math.inf
    if alarm is not None:
        clearly_before_mm = MM_PER_M * alarm.depth_m - MIN_BETWEEN_RUPTURES_MM
    ruptures = read_column(mixture.assumptions, "ruptures")
    denies_alarm = read_column(mixture.history, "rupture_mm") < clearly_before_mm
    without_alarm = np.minimum(ruptures, reported - 1.0)
    counted = np.where(denies_alarm, without_alarm, ruptures)
    return Evidence(mixture, mixture.weights, counted)


def count_recent_in_full(evidence: Evidence, noise_fraction: float) -> Evidence:
    """Return the evidence with weights that count the last blocks' likelihood in full.

    A mixture's own weights temper it, for what is learnt over millimetres repeats the
    model's own errors. What is heard within a tenth of a second differs by noise, but
    for tissue that moves.

    Args:
        evidence: With the mixture's own weights.
        noise_fraction: Part of white noise in what changes the force, 0 to 1.
    """
    recent = read_column(evidence.mixture.history, "recent_log")
    logs = evidence.mixture.log_weights + noise_fraction * recent
    weights = np.exp(logs - logs.max())
    return evidence._replace(weights=weights / weights.sum())
