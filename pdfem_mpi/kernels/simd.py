"""Four float64 numbers as one value inside compiled functions (256-bit SIMD), or eight where a name ends in 8.

Eight are one register on a processor with AVX-512, and two on others, with the same bits.

No operation carries a fast-math flag and every fused multiply-add is written out, so the compiled code does
exactly the written operations: the bits of a result do not depend on the lane, on the place in a list, or on
how the compiler copies a loop. That is what makes results equal on any number of ranks.

With ``NUMBA_DISABLE_JIT=1`` the same names work on numpy arrays of four numbers, slowly and with bounds
checked (``fma`` then rounds twice, so the last bits differ from compiled code).

The order-independent sums use *bit patterns*: for ``M = 1.5 * 2**52 * quantum`` the pattern of ``p + M`` is
``bits(M) + round(p / quantum)`` while ``|p| < 2**51 * quantum``, and 64-bit integers add in any order.
"""

import operator

import numba
import numpy as np

W = 4  #: lanes
PATTERN = 1.5 * 2.0**52  #: M / quantum

if numba.config.DISABLE_JIT:

    def _entries(array, index, n):
        start = int(index)
        if start < 0 or start + n > array.size:
            raise IndexError(f"lanes {start}:{start + n} of an array of {array.size}")
        return array[start : start + n]

    def load(array, index):
        """Four consecutive entries of a flat float64 or float32 array."""
        return _entries(array, index, W).astype(np.float64)

    def load8(array, index):
        """Eight consecutive entries of a flat float64 or float32 array."""
        return _entries(array, index, 2 * W).astype(np.float64)

    def store(array, index, v):
        """Write as many consecutive entries of a flat float64 array as there are lanes."""
        _entries(array, index, len(v))[:] = v

    def prefetch(array, index):
        """Ask for the memory around an entry, which may lie outside of the array, ahead of its use."""

    def splat(x):
        """The number ``x`` in all lanes."""
        return np.full(W, x)

    def splat8(x):
        """The number ``x`` in eight lanes."""
        return np.full(2 * W, x)

    def held(x):
        """The number ``x`` in all lanes."""
        return np.full(W, x)

    def fma(x, y, z):
        """``x * y + z``."""
        return x * y + z

    def fnma(x, y, z):
        """``z - x * y``."""
        return z - x * y

    def root(x):
        """Square root."""
        return np.sqrt(x)

    def iadd(x, y):
        """Sum of the bit patterns as integers."""
        return (x.view(np.int64) + y.view(np.int64)).view(np.float64)

    def isub(x, y):
        """Difference of the bit patterns as integers."""
        return (x.view(np.int64) - y.view(np.int64)).view(np.float64)

    def both(x, mask):
        """``x`` where the mask is set, else 0."""
        return (x.view(np.int64) & mask.view(np.int64)).view(np.float64)

    def either(x, y):
        """The bits that one of both has."""
        return (x.view(np.int64) | y.view(np.int64)).view(np.float64)

    def unequal(x, y):
        """Lane mask of ``x != y``, which holds for NaN."""
        return np.where(x != y, np.int64(-1), np.int64(0)).view(np.float64)

    def magnitude(x):
        """Absolute value."""
        return np.abs(x)

    def largest(x, y):
        """Lane by lane ``x if x > y else y``."""
        return np.where(x > y, x, y)

    def smallest(x, y):
        """Lane by lane ``x if x < y else y``."""
        return np.where(x < y, x, y)

    def above(x, y):
        """Lane mask of ``x > y``."""
        return np.where(x > y, np.int64(-1), np.int64(0)).view(np.float64)

    def lanes(mask):
        """Integer whose bit k is the sign bit of lane k."""
        return int(sum(1 << k for k in range(len(mask)) if mask.view(np.int64)[k] < 0))

    def hmax(v):
        """Largest of the lanes."""
        return float(v.max())

    def hmin(v):
        """Smallest of the four lanes."""
        return float(v.min())

    def hsum(v):
        """``(v0 + v1) + (v2 + v3)``."""
        return float((v[0] + v[1]) + (v[2] + v[3]))

    def ihsum(v):
        """Integer sum of the four bit patterns (wraps)."""
        return v.view(np.int64).sum()

    def bits(x):
        """Bit pattern of a float64 as int64."""
        return np.float64(x).view(np.int64)

    def from_bits(pattern):
        """The float64 that has a bit pattern."""
        return np.int64(pattern).view(np.float64)

else:
    from llvmlite import ir
    from numba import types
    from numba.core import cgutils
    from numba.extending import intrinsic, models, overload, register_model

    _F, _I, _B = ir.DoubleType(), ir.IntType(64), ir.IntType(32)

    class Vec(types.Type):
        """Numba type of a value of some float64."""

        def __init__(self, width):
            self.width = width
            super().__init__(name=f"v{width}f64")

    V4, V8 = Vec(W), Vec(2 * W)

    def _vector(width, entry=_F):
        return ir.VectorType(entry, width)

    @register_model(Vec)
    class _VecModel(models.PrimitiveModel):
        def __init__(self, dmm, fe_type):
            super().__init__(dmm, fe_type, _vector(fe_type.width))

    def _as_integers(builder, x):
        return builder.bitcast(x, _vector(x.type.count, _I))

    def _address(context, builder, array_type, array, index, vector):
        data = builder.gep(context.make_array(array_type)(context, builder, array).data, [index])
        return builder.bitcast(data, vector.as_pointer())

    def _loading(vec, doc):
        @intrinsic
        def operation(typingctx, array, index):
            def codegen(context, builder, sig, args):
                single = sig.args[0].dtype is types.float32
                vector = _vector(vec.width, ir.FloatType() if single else _F)
                v = builder.load(_address(context, builder, sig.args[0], args[0], args[1], vector))
                v.align = 4 if single else 8
                return builder.fpext(v, _vector(vec.width)) if single else v

            return vec(array, types.intp), codegen

        operation.__doc__ = doc
        return operation

    load = _loading(V4, "Four consecutive entries of a flat float64 or float32 array (widened).")
    load8 = _loading(V8, "Eight consecutive entries of a flat float64 or float32 array (widened).")

    @intrinsic
    def store(typingctx, array, index, v):
        """Write as many consecutive entries of a flat float64 array as there are lanes."""

        def codegen(context, builder, sig, args):
            s = builder.store(args[2], _address(context, builder, sig.args[0], args[0], args[1], args[2].type))
            s.align = 8
            return context.get_dummy_value()

        return types.void(array, types.intp, v), codegen

    @intrinsic
    def prefetch(typingctx, array, index):
        """Ask for the memory around an entry, which may lie outside of the array, ahead of its use."""

        def codegen(context, builder, sig, args):
            data = builder.gep(context.make_array(sig.args[0])(context, builder, args[0]).data, [args[1]])
            byte = ir.IntType(8).as_pointer()
            signature = ir.FunctionType(ir.VoidType(), [byte, _B, _B, _B])
            function = cgutils.get_or_insert_function(builder.module, signature, "llvm.prefetch.p0")
            to_read, near, data_cache = (ir.Constant(_B, flag) for flag in (0, 3, 1))
            builder.call(function, [builder.bitcast(data, byte), to_read, near, data_cache])
            return context.get_dummy_value()

        return types.void(array, types.intp), codegen

    def _in_all_lanes(builder, x, width=W):
        v = builder.insert_element(ir.Constant(_vector(width), ir.Undefined), x, ir.Constant(_B, 0))
        return builder.shuffle_vector(v, v, ir.Constant(_vector(width, _B), [0] * width))

    def _hidden(builder, x):
        pattern = builder.asm(ir.FunctionType(_I, [_I]), "", "=r,0", [builder.bitcast(x, _I)], False)
        return builder.bitcast(pattern, _F)

    @intrinsic
    def held(typingctx, x):
        """The number ``x`` in all lanes, kept in a register: the compiler does not know that it could read it again."""

        def codegen(context, builder, sig, args):
            return _in_all_lanes(builder, _hidden(builder, args[0]))

        return V4(types.float64), codegen

    @intrinsic
    def splat(typingctx, x):
        """The number ``x`` in all lanes."""

        def codegen(context, builder, sig, args):
            return _in_all_lanes(builder, args[0])

        return V4(types.float64), codegen

    @intrinsic
    def splat8(typingctx, x):
        """The number ``x`` in eight lanes."""

        def codegen(context, builder, sig, args):
            return _in_all_lanes(builder, args[0], 2 * W)

        return V8(types.float64), codegen

    def _binary(name):
        @intrinsic
        def operation(typingctx, x, y):
            def codegen(context, builder, sig, args):
                return getattr(builder, name)(args[0], args[1])

            return x(x, x), codegen

        return operation

    def _register(python_operator, operation):
        def implementation(x, y):
            if isinstance(x, Vec) and isinstance(y, Vec):
                return lambda x, y: operation(x, y)

        overload(python_operator)(implementation)

    for _operator, _name in (
        (operator.add, "fadd"),
        (operator.sub, "fsub"),
        (operator.mul, "fmul"),
        (operator.truediv, "fdiv"),
    ):
        _register(_operator, _binary(_name))

    def _call(builder, name, *args):
        vector = args[0].type
        signature = ir.FunctionType(vector, [vector] * len(args))
        name = f"llvm.{name}.v{vector.count}f64"
        return builder.call(cgutils.get_or_insert_function(builder.module, signature, name), args)

    @intrinsic
    def fma(typingctx, x, y, z):
        """``x * y + z``, rounded once."""

        def codegen(context, builder, sig, args):
            return _call(builder, "fma", *args)

        return x(x, x, x), codegen

    @intrinsic
    def fnma(typingctx, x, y, z):
        """``z - x * y``, rounded once."""

        def codegen(context, builder, sig, args):
            return _call(builder, "fma", builder.fneg(args[0]), args[1], args[2])

        return x(x, x, x), codegen

    def _unary(name):
        @intrinsic
        def operation(typingctx, x):
            def codegen(context, builder, sig, args):
                return _call(builder, name, args[0])

            return x(x), codegen

        return operation

    root, magnitude = _unary("sqrt"), _unary("fabs")

    def _integer(name):
        @intrinsic
        def operation(typingctx, x, y):
            def codegen(context, builder, sig, args):
                result = getattr(builder, name)(*(_as_integers(builder, x) for x in args))
                return builder.bitcast(result, args[0].type)

            return x(x, x), codegen

        return operation

    iadd, isub, both, either = _integer("add"), _integer("sub"), _integer("and_"), _integer("or_")

    def _select(comparison):
        @intrinsic
        def operation(typingctx, x, y):
            def codegen(context, builder, sig, args):
                return builder.select(builder.fcmp_ordered(comparison, args[0], args[1]), args[0], args[1])

            return x(x, x), codegen

        return operation

    largest, smallest = _select(">"), _select("<")

    @intrinsic
    def above(typingctx, x, y):
        """Lane mask (all bits set or none) of ``x > y``."""

        def codegen(context, builder, sig, args):
            vector = args[0].type
            mask = builder.sext(builder.fcmp_ordered(">", args[0], args[1]), _vector(vector.count, _I))
            return builder.bitcast(mask, vector)

        return x(x, x), codegen

    @intrinsic
    def unequal(typingctx, x, y):
        """Lane mask (all bits set or none) of ``x != y``, which holds for NaN."""

        def codegen(context, builder, sig, args):
            vector = args[0].type
            mask = builder.sext(builder.fcmp_unordered("!=", args[0], args[1]), _vector(vector.count, _I))
            return builder.bitcast(mask, vector)

        return x(x, x), codegen

    @intrinsic
    def lanes(typingctx, mask):
        """Integer whose bit k is the sign bit of lane k."""

        def codegen(context, builder, sig, args):
            width = args[0].type.count
            m = builder.icmp_signed("<", _as_integers(builder, args[0]), ir.Constant(_vector(width, _I), [0] * width))
            return builder.zext(builder.bitcast(m, ir.IntType(width)), _I)

        return types.int64(mask), codegen

    def _horizontal(combine, integer=False):
        @intrinsic
        def operation(typingctx, v):
            def codegen(context, builder, sig, args):
                value = _as_integers(builder, args[0]) if integer else args[0]
                x = [builder.extract_element(value, ir.Constant(_B, k)) for k in range(value.type.count)]
                while len(x) > 1:
                    x = [combine(builder, x[k], x[k + 1]) for k in range(0, len(x), 2)]
                return x[0]

            return (types.int64 if integer else types.float64)(v), codegen

        return operation

    def _pick(comparison):
        return lambda builder, x, y: builder.select(builder.fcmp_ordered(comparison, x, y), x, y)

    hsum = _horizontal(lambda builder, x, y: builder.fadd(x, y))
    ihsum = _horizontal(lambda builder, x, y: builder.add(x, y), integer=True)
    hmax, hmin = _horizontal(_pick(">")), _horizontal(_pick("<"))

    @intrinsic
    def bits(typingctx, x):
        """Bit pattern of a float64 as int64."""

        def codegen(context, builder, sig, args):
            return builder.bitcast(args[0], _I)

        return types.int64(types.float64), codegen

    @intrinsic
    def from_bits(typingctx, pattern):
        """The float64 that has a bit pattern."""

        def codegen(context, builder, sig, args):
            return builder.bitcast(args[0], _F)

        return types.float64(types.int64), codegen
