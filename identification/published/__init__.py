"""The method as published by Ferro et al.: online (7)-(12) and offline (4)-(6).

Reading order: `offline`, `online`.
"""
