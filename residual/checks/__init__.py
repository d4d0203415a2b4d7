"""Checks of the samples and of the estimates that are made of them.

Reading order: `input` (shape and size of numbers), `outliers` (spikes, saturated
torques), `stuck_signals` (what repeats bit for bit), `velocity` (dq against the rate of
q), `pushed_arm` (a hand on the arm), `monitor` (what is checked every few samples).
"""
