"""Rows of a point side by side: two in eight lanes where the processor has AVX-512, one in four elsewhere.

A row is four slots (`bond_sweeps`). Two consecutive rows of a point have their numbers beside each other in memory,
but their clusters stand apart in the table: what is read there is joined from two halves, and written as two. Each lane
does what it does in a row alone, so that the bits do not depend on how many rows go abreast. All rows of a point are at
different clusters: otherwise the second half would be written over the first.

Every function takes the number of rows, 1 or 2, as a constant, or has it from the *places* of the rows' clusters, a
tuple of as many numbers. With ``NUMBA_DISABLE_JIT=1`` the same names work on numpy arrays, as those of `simd` do.
"""

import numba
import numpy as np
from llvmlite import binding

from pdfem_mpi.kernels import simd
from pdfem_mpi.kernels.simd import W

_NEEDED = {"avx512f", "avx512dq", "avx512vl"}


def rows_abreast(config=numba.config) -> int:
    """How many rows the sweeps take at once on the processor that numba compiles for.

    The cache of compiled kernels tells processors apart by the same name and features, so that it never has a kernel of
    the other width for one of them. A processor that ``NUMBA_CPU_NAME`` names has what ``NUMBA_CPU_FEATURES`` says.
    """
    if config.CPU_FEATURES is not None:
        features = {word[1:] for word in config.CPU_FEATURES.split(",") if word.startswith("+")}
    elif not config.ENABLE_AVX or config.CPU_NAME not in (None, binding.get_host_cpu_name()):
        return 1
    else:
        features = {name for name, is_there in binding.get_host_cpu_features().items() if is_there}
    return 2 if features >= _NEEDED else 1


ROWS = rows_abreast()  #: rows abreast here

if numba.config.DISABLE_JIT:

    def spread(rows, x):
        """The number ``x`` in all lanes of the rows."""
        return np.full(W * rows, x)

    def held(rows, x):
        """The number ``x`` in all lanes of the rows."""
        return np.full(W * rows, x)

    def places_of(rows, row_offset, r):
        """Places of the clusters of rows from ``r`` on, a tuple of uint64."""
        return tuple(np.uint64(offset) for offset in simd._entries(row_offset, r, rows))

    def points_of(places):
        """Where the first points of the clusters stand in an array with a number for each point."""
        return tuple(place // np.uint64(9) for place in places)

    def gather(array, places, shift):
        """Four entries for each row, at its place and ``shift`` behind."""
        return np.concatenate([simd.load(array, place + shift) for place in places])

    def _scattering(combine):
        def scatter(array, places, shift, v):
            for k, place in enumerate(places):
                there = simd.load(array, place + shift)
                simd.store(array, place + shift, combine(there, v[W * k : W * k + W]))

        return scatter

    take_from, add_to = _scattering(simd.isub), _scattering(simd.iadd)

    def numbers(rows, array, index):
        """Numbers of the rows' slots where a slot has one: consecutive entries from ``index`` on."""
        return simd._entries(array, index, W * rows).astype(np.float64)

    def two_numbers(rows, array, index):
        """First and second numbers of the rows' slots where a slot has two: four of the first, four of the second."""
        both = simd._entries(array, index, 2 * W * rows).astype(np.float64).reshape(rows, 2, W)
        return both[:, 0].reshape(-1), both[:, 1].reshape(-1)

    def of_first(v):
        """The lanes of the first row."""
        return v[:W]

    def for_all(rows, v):
        """The lanes of one row in those of each."""
        return np.tile(v, rows)

    def for_first(rows, v):
        """The lanes of one row in those of the first, +0 in others."""
        return np.concatenate([v, np.zeros(W * (rows - 1))])

else:
    from llvmlite import ir
    from numba import types
    from numba.core import cgutils
    from numba.extending import intrinsic

    _VECTORS = {1: simd.V4, 2: simd.V8}
    _I = ir.IntType(64)

    def _part(builder, v, first, n):
        """Lanes of a vector, or of two beside each other."""
        x, y = v if isinstance(v, list) else (v, v)
        lanes = ir.Constant(ir.VectorType(ir.IntType(32), n), [first + k for k in range(n)])
        return builder.shuffle_vector(x, y, lanes)

    def _joined(builder, vectors):
        return vectors[0] if len(vectors) == 1 else _part(builder, vectors, 0, 2 * vectors[0].type.count)

    def _in_all_lanes(doc, hide):
        @intrinsic(prefer_literal=True)
        def operation(typingctx, rows, x):
            n = rows.literal_value

            def codegen(context, builder, sig, args):
                number = simd._hidden(builder, args[1]) if hide else args[1]
                return simd._in_all_lanes(builder, number, W * n)

            return _VECTORS[n](rows, types.float64), codegen

        operation.__doc__ = doc
        return operation

    spread = _in_all_lanes("The number ``x`` in all lanes of the rows.", hide=False)
    held = _in_all_lanes("The number ``x`` in all lanes of the rows, kept in a register as by `simd.held`.", hide=True)

    @intrinsic(prefer_literal=True)
    def places_of(typingctx, rows, row_offset, r):
        """Places of the clusters of rows from ``r`` on, a tuple of uint64."""
        n = rows.literal_value

        def codegen(context, builder, sig, args):
            data = builder.gep(context.make_array(sig.args[1])(context, builder, args[1]).data, [args[2]])
            offsets = [builder.load(builder.gep(data, [ir.Constant(_I, k)])) for k in range(n)]
            return cgutils.pack_array(builder, [builder.zext(offset, _I) for offset in offsets])

        return types.UniTuple(types.uint64, n)(rows, row_offset, types.uint64), codegen

    @intrinsic
    def points_of(typingctx, places):
        """Where the first points of the clusters stand in an array with a number for each point."""

        def codegen(context, builder, sig, args):
            nine = ir.Constant(_I, 9)
            return cgutils.pack_array(builder, [builder.udiv(p, nine) for p in cgutils.unpack_tuple(builder, args[0])])

        return places(places), codegen

    def _addresses(context, builder, sig, args, vector):
        """Where the four entries of each row stand."""
        places = [builder.add(place, args[2]) for place in cgutils.unpack_tuple(builder, args[1])]
        return [simd._address(context, builder, sig.args[0], args[0], place, vector) for place in places]

    def _loaded(builder, address, align):
        v = builder.load(address)
        v.align = align
        return v

    @intrinsic
    def gather(typingctx, array, places, shift):
        """Four entries for each row, at its place and ``shift`` behind."""

        def codegen(context, builder, sig, args):
            addresses = _addresses(context, builder, sig, args, simd._vector(W))
            return _joined(builder, [_loaded(builder, address, 8) for address in addresses])

        return _VECTORS[places.count](array, places, types.uint64), codegen

    def _scattering(name, doc):
        @intrinsic
        def operation(typingctx, array, places, shift, v):
            def codegen(context, builder, sig, args):
                addresses = _addresses(context, builder, sig, args, simd._vector(W, _I))
                there = _joined(builder, [_loaded(builder, address, 8) for address in addresses])
                result = getattr(builder, name)(there, simd._as_integers(builder, args[3]))
                for k, address in enumerate(addresses):
                    builder.store(_part(builder, result, W * k, W), address).align = 8
                return context.get_dummy_value()

            return types.void(array, places, types.uint64, v), codegen

        operation.__doc__ = doc
        return operation

    take_from = _scattering("sub", "Take bit patterns, as integers, from the four entries of each row.")
    add_to = _scattering("add", "Add bit patterns, as integers, to the four entries of each row.")

    def _widened(context, builder, sig, args, shift, n):
        """``n`` float32 entries as float64."""
        index = builder.add(args[2], ir.Constant(_I, shift))
        vector = simd._vector(n, ir.FloatType())
        address = simd._address(context, builder, sig.args[1], args[1], index, vector)
        return builder.fpext(_loaded(builder, address, 4), simd._vector(n))

    @intrinsic(prefer_literal=True)
    def numbers(typingctx, rows, array, index):
        """Numbers of the rows' slots where a slot has one: consecutive entries from ``index`` on."""
        n = rows.literal_value

        def codegen(context, builder, sig, args):
            return _widened(context, builder, sig, args, 0, W * n)

        return _VECTORS[n](rows, array, types.uint64), codegen

    @intrinsic(prefer_literal=True)
    def two_numbers(typingctx, rows, array, index):
        """First and second numbers of the rows' slots where a slot has two: four of the first, four of the second."""
        n = rows.literal_value

        def codegen(context, builder, sig, args):
            pieces = [_widened(context, builder, sig, args, 2 * W * k, 2 * W) for k in range(n)]
            halves = [[_part(builder, piece, W * k, W) for piece in pieces] for k in range(2)]
            if n == 1:
                halves = [[_widened(context, builder, sig, args, W * k, W)] for k in range(2)]
            return cgutils.pack_array(builder, [_joined(builder, half) for half in halves])

        return types.UniTuple(_VECTORS[n], 2)(rows, array, types.uint64), codegen

    @intrinsic
    def of_first(typingctx, v):
        """The lanes of the first row."""

        def codegen(context, builder, sig, args):
            return _part(builder, args[0], 0, W)

        return _VECTORS[1](v), codegen

    @intrinsic(prefer_literal=True)
    def for_all(typingctx, rows, v):
        """The lanes of one row in those of each."""
        n = rows.literal_value

        def codegen(context, builder, sig, args):
            return _joined(builder, [args[1]] * n)

        return _VECTORS[n](rows, v), codegen

    @intrinsic(prefer_literal=True)
    def for_first(typingctx, rows, v):
        """The lanes of one row in those of the first, +0 in others."""
        n = rows.literal_value

        def codegen(context, builder, sig, args):
            return _joined(builder, [args[1], *[ir.Constant(args[1].type, None)] * (n - 1)])

        return _VECTORS[n](rows, v), codegen
