"""Types that every floor uses: arrays by their elements, callbacks by what they are given."""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

Notify = Callable[[str], None]  # one sentence for the user


class ProgressCallback(Protocol):
    """Callback for the progress of work: number done, number in all, and what is done now."""

    def __call__(self, done: int, total: int, note: str = "", /) -> None: ...
