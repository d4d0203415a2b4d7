"""A block of samples: means over up to 10 ms, which every hypothesis predicts."""

from typing import NamedTuple

MM_PER_M = 1e3
"""Millimetres per metre."""


class Block(NamedTuple):
    """Where the tip is at the middle of a block, and how well that is known.

    Attributes:
        time_s: Since the reset.
        duration_s: Length of the block.
        depth_mm: Filtered depth in the tissue.
        speed_mm_s: Speed of the needle in the tissue.
        deflection: Presliding deflection, 1 where the shaft slides inwards, -1 where it
            slides outwards.
        force_N: Mean axial force.
        usual_speed_mm_s: Highest speed of the last ten seconds and three millimetres.
        noise_std_N: Standard deviation of a block's force that no hypothesis explains.
        unfiltered_depth_mm: Mean of the depths before the filter.
        speed_lag_s: By which the filtered speed may be late.
        force_before_N: Mean axial force of the block before.
        force_by_speed_N: Shaft friction that changes of the speed have added so far.
        model_error_N: Standard deviation of the force model's error that the tissue's
            texture shows.
        force_std_N: Standard deviation of the force's slow error, 0 of a force sensor.
        depth_std_mm: Standard deviation of the depth's noise.
        speed_std_mm_s: Standard deviation of the speed's noise.
        motion_variance_N2: Variance of the force where the arm accelerates.
        is_swing: Whether the block is a whole swing of the needle.
        swing_std_N: Standard deviation of the force within that swing; 0 without one.
    """

    time_s: float = 0.0
    duration_s: float = 0.0
    depth_mm: float = 0.0
    speed_mm_s: float = 0.0
    deflection: float = 0.0
    force_N: float = 0.0
    usual_speed_mm_s: float = 0.0
    noise_std_N: float = 0.0
    unfiltered_depth_mm: float = 0.0
    speed_lag_s: float = 0.0
    force_before_N: float = 0.0
    force_by_speed_N: float = 0.0
    model_error_N: float = 0.0
    force_std_N: float = 0.0
    depth_std_mm: float = 0.0
    speed_std_mm_s: float = 0.0
    motion_variance_N2: float = 0.0
    is_swing: bool = False
    swing_std_N: float = 0.0
