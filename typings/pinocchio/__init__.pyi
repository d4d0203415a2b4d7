# Pinocchio's Python module is built at import time by its C++ bindings; no stubs exist for it.
from typing import Any

def __getattr__(name: str) -> Any: ...
