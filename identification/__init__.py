"""Needle-tissue interaction from depth, speed and axial force; knows nothing of robots."""
