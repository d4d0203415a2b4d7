"""The patient's anatomy against analytic shapes and a real CT.

Parts: `path`, `registration`, `patient`.
"""

CT_FOLDER = "torso_ct_totalsegmentator"
"""Of the recordings."""
