"""What an update costs, beside its bare dynamics and beside other libraries.

Reading order: `ticks` (single updates, also beside a tare), `control` (control), `soak`
(a million updates), `stream` (long recordings), `loop` (a 1 kHz loop), `kdl` (orocos
KDL).
"""
