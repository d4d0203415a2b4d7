"""Demonstrations in simulation: the needle in closed loop, and from a CT to its target.

Reading order: `closed_loops` (which there are), `result_page`, `guidance`,
`remote_centre`, `autonomous`, `teleoperation` with `hand_driven`, `abdomen_plan`,
`abdomen_insertion`, `abdomen_page`.
"""
