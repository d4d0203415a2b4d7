"""Needle-tip force from a robot's joint torques: the front door of the toolkit."""
