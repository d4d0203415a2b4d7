"""Demonstrations in simulation: the needle in closed loop, and from a CT to its target.

Reading order: `insertion_run` (the first command), `insertion_page`; then
`closed_loops` (which there are), `result_page`, `guidance`,
`remote_centre`, `autonomous`, `teleoperation` with `hand_driven`, `abdomen_plan`,
`abdomen_insertion`, `abdomen_page`.
"""
