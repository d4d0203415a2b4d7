"""Robot descriptions shipped with the package; read them through :mod:`importlib.resources`."""
