"""Runs of many jobs.

Reading order: `workers` (who does the jobs), `runs` (what is kept of them, and
resumed).
"""
