"""The time of a recording: stamps without loss, and what is wrong with them.

Reading order: `nanoseconds`, `whole_stamps`, `time_channel`, `row_clock`, `time_stamps`.
"""
