"""Checks of the samples and of the estimates that are made of them.

Reading order: `input` (shape and size of numbers, NaN), `outliers` (spikes, saturated
or frozen torques, by their `noise`), `velocity` (dq against the rate of q),
`torque_watch` (a hand on the arm, a torque sensor that jumps), `monitor` (what is
checked every few samples). A sample that is refused raises a `SampleError` here;
`VirtualForceSensor` turns it into the status ``REJECTED`` and the last estimate.
"""
