"""Views of arrays for kernels without Numba's run time."""

import math
from typing import Any

import numba
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np import arrayobj


def _view(typing_context: Any, buffer: Any, start: Any, shape: Any) -> Any:
    """Create a view of shape `shape` from entry `start` of the one-dimensional `buffer`, which must
    outlive it."""
    result = types.Array(buffer.dtype, shape.count, "C")

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = arrayobj.make_array(buffer)(context, builder, arguments[0]).data
        item = context.get_abi_sizeof(context.get_data_type(buffer.dtype))
        word = context.get_value_type(types.intp)
        lengths = cgutils.unpack_tuple(builder, arguments[2])
        strides = [word(item)]
        for length in reversed(lengths[1:]):
            strides.insert(0, builder.mul(strides[0], length))
        array = arrayobj.make_array(result)(context, builder)
        arrayobj.populate_array(
            array,
            data=builder.gep(data, [arguments[1]]),
            shape=lengths,
            strides=strides,
            itemsize=word(item),
            meminfo=None,
        )
        return array._getvalue()

    return result(buffer, types.intp, types.UniTuple(types.intp, shape.count)), generate


def _view_in_python(buffer: Any, start: int, shape: tuple[int, ...]) -> Any:
    return buffer[start : start + math.prod(shape)].reshape(shape)


_config: Any = numba.config
view: Any = _view_in_python if _config.DISABLE_JIT else intrinsic(_view)
