"""Robot descriptions shipped with the package; read them through
`importlib.resources`.
"""
