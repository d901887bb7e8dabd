"""Arrays without reference counts, for kernels that look at many arrays from many threads.

numba counts references to an array whenever it is taken out of a tuple or handed on, atomically. In a
path tracer, where every look-up starts from a tuple of arrays that all threads share, the counters' cache
lines travel from core to core and take several times as long as the tracing. The arguments of a kernel
called from Python live until it returns, so their counts need not be kept inside: `borrow` drops them.
"""

from __future__ import annotations

from typing import Any

from gonio.core import jit

if jit.disabled:

    def borrow(value):
        """The value itself."""
        return value

else:
    from numba import types
    from numba.extending import intrinsic

    def _strip(context: Any, builder: Any, kind: Any, value: Any) -> Any:
        if isinstance(kind, types.Array):
            array = context.make_array(kind)(context, builder, value)
            array.meminfo = context.get_constant_null(types.MemInfoPointer(kind.dtype))
            array.parent = context.get_constant_null(types.pyobject)
            return array._getvalue()
        if isinstance(kind, types.BaseTuple):
            parts = [builder.extract_value(value, i) for i in range(len(kind))]
            items = [_strip(context, builder, kind[i], part) for i, part in enumerate(parts)]
            return context.make_tuple(builder, kind, items)
        return value

    @intrinsic
    def borrow(_typing, value):
        """The array, or (named) tuple of arrays, `value` without reference counts.

        Valid only while the original lives: use it on arguments that come from Python, nothing else.
        """

        def generate(context, builder, signature, arguments):
            return _strip(context, builder, signature.args[0], arguments[0])

        return value(value), generate
