"""The needle in closed loop, on the simulated arm.

Reading order: `study` (what can be run), `loop` (arm and controller), then the parts:
`priority`, `constraints`, `guidance`, `teleoperation`, `autonomous`, `faults`;
`published` is the peer.
"""
