"""Robot descriptions shipped with the package, read by `importlib.resources`."""
