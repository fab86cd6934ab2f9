"""Types of arrays that all packages use; shapes and units stand where they are used."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

Points = Annotated[Array, "(N, 3)"]
"""N positions or vectors, (N, 3)."""
Stamp = Annotated[float, "stamp"]
"""s; a time in messages."""
