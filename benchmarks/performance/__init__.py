"""What an update costs, beside its bare dynamics and beside other libraries.

Reading order: `ticks` (single updates), `control` (control), `kdl` (orocos KDL).
"""
