"""The needle in closed loop, on the simulated arm.

Reading order: `loop` (arm and controller), then the parts: `constraints`, `autonomous`,
`teleoperation` (with the hand of `hand_driven`). A part has the names of its cases,
`CASES`, and ``run(job)``, which yields the numbers of one run of some seconds.
"""
