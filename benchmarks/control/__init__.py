"""The needle in closed loop, on the simulated arm.

Reading order: `loop` (arm and controller), then the parts: `priority`, `limits`,
`constraints`, `guidance`, `teleoperation`, `autonomous`, `pulls`, `faults`; `published`
is the peer. A part has the names of its cases, `CASES`, and ``run(job)``,
which yields the numbers of one run of some seconds.
"""
