"""What an update costs, beside its bare dynamics and beside other libraries.

Reading order: `speed` (single updates), `long_runs` (a million updates, long
recordings), `control_speed` (control), `device_loop` (a 1 kHz loop), `kdl_peer` (orocos
KDL).
"""
