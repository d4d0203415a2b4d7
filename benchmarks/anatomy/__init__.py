"""The patient's anatomy against analytic shapes and a real CT.

Parts: `surface`, `path`, `obstacles`, `agreement`, `deviation`, `registration`,
`patient`, `match`, `abdomen`, `fullsize`.
"""

CT_FOLDER = "torso_ct_totalsegmentator"
"""Of the recordings."""
