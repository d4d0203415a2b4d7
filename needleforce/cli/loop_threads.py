"""Threads of linear algebra in commands that keep up with an arm."""

import os

VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Where the libraries look, when they are loaded, how many threads they may use."""


def limit_library_threads() -> None:
    """Let linear algebra compute in one thread, unless the user has said otherwise.

    Threads that wait for each other on busy cores take seconds for what one does in
    milliseconds, and the arm is not answered meanwhile. Call it before numpy is loaded.
    """
    for variable in VARIABLES:
        os.environ.setdefault(variable, "1")
