"""Types of arrays in signatures.

`Array` is any array of floats. The others also say to the compiler how many dimensions
an argument has (see `foundation.jit.compiled`); all are contiguous in rows. A function
writes only into arguments of the ``Written`` types.
"""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""An array of floats of any shape."""

Vector = Annotated[Array, 1]
"""Array of shape (n,), contiguous."""

Matrix = Annotated[Array, 2]
"""Array of shape (m, n), contiguous in rows."""

Blocks = Annotated[Array, 3]
"""Array of shape (k, m, n), contiguous in rows."""

WrittenVector = Annotated[Array, 1, "written"]
"""Array of shape (n,) into which a compiled function writes."""

WrittenMatrix = Annotated[Array, 2, "written"]
"""Array of shape (m, n) into which a compiled function writes."""

WrittenBlocks = Annotated[Array, 3, "written"]
"""Array of shape (k, m, n) into which a compiled function writes."""
