"""The patient's anatomy against analytic shapes and a real CT.

Reading order: `study` (what can be run), then the parts: `surface`, `path`,
`obstacles`, `agreement`, `deviation`, `registration`, `match`, `abdomen`, `fullsize`.
"""
