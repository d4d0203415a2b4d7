# Pinocchio's Python module is built at import time by its C++ bindings; it has no
# stubs.
from typing import Any

def __getattr__(name: str) -> Any: ...
