"""Types that every floor uses: arrays by their elements, callbacks by what they are given."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

if TYPE_CHECKING:

    class ArrayField:
        """Array with a default in a dataclass that converts it: given as anything array-like."""

        def __get__(self, instance: object, owner: Any = None) -> FloatArray: ...
        def __set__(self, instance: object, value: ArrayLike) -> None: ...

    class OptionalArrayField:
        """The same, or None."""

        def __get__(self, instance: object, owner: Any = None) -> FloatArray | None: ...
        def __set__(self, instance: object, value: ArrayLike | None) -> None: ...

else:
    ArrayField = FloatArray
    OptionalArrayField = FloatArray | None

Notify = Callable[[str], None]  # one sentence for the user


class ProgressCallback(Protocol):
    """Callback for the progress of work: number done, number in all, and what is done now."""

    def __call__(self, done: int, total: int, note: str = "", /) -> None: ...
