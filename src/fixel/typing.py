"""Types that every floor uses: arrays by their elements, callbacks by what they are given."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

Progress = Callable[[int, int], None]  # number done, number in all
NotedProgress = Callable[[int, int, str], None]  # the same, and what is done now
Notify = Callable[[str], None]  # one sentence for the user
