"""Codes in tables of forces: ``residual`` writes them, ``identification`` reads them."""

FORCE_STATUS = ("ok", "not tared", "settling", "skipped")
"""What 0, 1, 2, ... of the column `force_status` mean; only the first is a usable force."""
WORTHLESS = {
    "frozen": 2,
    "joint limit": 8,
    "near singular": 16,
    "misfit": 32,
    "stale": 64,
    "velocity": 128,
}
"""Bits of the column `force_cautions` that make a force worthless to an identifier."""
