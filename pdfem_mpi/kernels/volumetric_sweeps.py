"""Bond forces where Poisson's ratio is not 1/4, the second of two sweeps, and their tangent in finite kinematics.

A bond's force has a share of its own and one of its points, ``T_ij = k_ij [s_ij + q_i + q_j]`` along the (deformed)
bond, where ``q = M theta / (10 mu)`` stands at the points (`dilatations.make_pressures`)::

    linear      f = K' [(eta . xi) + r0^2 (q_i + q_j)] xi
    finite      f = K [phi + (1 - phi) (q_i + q_j)] (d + eta)
    tangent     2 K { [phi + (1 - phi) Q] v + [(1 - Q) (1 - phi)^3 / r0^2 (y . v) + (1 - phi) Q'] y }

with ``Q = q_i + q_j`` and ``Q'`` its change. Numbers, table and rounding are those of `bond_sweeps` and
`bond_tangent`. Nothing breaks here: bonds break in the sweep of the dilatations.
"""

from numba import njit, types

from pdfem_mpi.kernels.abreast import ROWS, gather, held, numbers, of_first, places_of, points_of, spread, two_numbers
from pdfem_mpi.kernels.bond_response import (
    ONE,
    STEP,
    V1,
    V2,
    V3,
    V4,
    V5,
    V6,
    V7,
    V8,
    ZERO,
    add_own,
    added,
    added_first,
    ask_ahead,
    first_numbers,
    first_three,
    numbers_of,
    response_by_series,
    response_in_closed_form,
    rounded,
    take_forces,
    three,
    u8,
    work_of,
)
from pdfem_mpi.kernels.simd import W, fma, fnma, hmax, iadd, ihsum, isub, largest, load, magnitude, splat, store

_NINE = u8(9)
_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(inline="always")
def _common(rows, q, Q, b, weights, r, weighted):
    """``q_i + q_j`` of the slots of rows from ``r`` on, with fitted weights or without."""
    there = gather(Q, points_of(b), ZERO)
    if weighted:
        w, w_there = two_numbers(rows, weights, r * STEP)
        return q * w + there * w_there  # alike from both ends
    return q + there


@njit(inline="always")
def _pulled(rows, row_data, r, S, b, u, z, q, Q, weights, weighted):
    """``K' [(eta . xi) + r0^2 (q_i + q_j)]`` and ``xi`` of the slots of rows from ``r`` on."""
    work, _, xi = work_of(S, b, u, z)
    common = _common(rows, q, Q, b, weights, r, weighted)
    square = fma(xi[0], xi[0], fma(xi[1], xi[1], xi[2] * xi[2]))
    return numbers(rows, row_data, r * V1) * fma(square, common, work), xi


@njit(inline="always")
def _stretched(rows, row_data, r, S, b, u, z, q, Q, weights, weighted, response, closed):
    """``K [phi + (1 - phi) (q_i + q_j)]`` and ``d + eta`` of the slots of rows from ``r`` on."""
    k, inverse_square = two_numbers(rows, row_data, r * STEP)
    work, eta, d = work_of(S, b, u, z)
    e, one = work * inverse_square, response[5]
    phi = response_in_closed_form(one, e, response) if closed else response_by_series(one, e, response)
    common = _common(rows, q, Q, b, weights, r, weighted)
    return k * (phi + fnma(phi, common, common)), (d[0] + eta[0], d[1] + eta[1], d[2] + eta[2])


def force_sweep(finite, closed, weighted, rows=ROWS):
    """Build the sweep of the forces in finite kinematics, ``phi`` in closed form or as a series, or in linear ones.

    With fitted weights or without, for ``rows`` abreast; all are constants to the compiler.
    """
    step, rest, stride = u8(rows), u8(rows - 1), STEP if finite else V1

    @njit(**_options)
    def add_volumetric_forces(first, last, row_start, row_offset, row_data, S, SI, table, Q, weights):
        """Add the force of every bond of the rows of points ``first:last`` to both of its points.

        Parameters
        ----------
        first, last, row_start, row_offset, row_data, S, SI, table
            As in `bond_sweeps`.
        Q : float64, shape (n_clusters * 4,)
            ``q`` of all points.
        weights : float32, shape ((n_rows + 1) * 8,) or (0,)
            As in `dilatation_sweeps`.

        Returns
        -------
        int
            ``last``.
        """
        zero = spread(rows, 0.0)
        response = numbers_of(rows, table)
        M = held(rows, table[V5])
        for i in range(first, last):
            r = u8(row_start[i])
            end = u8(row_start[i + 1])
            if end <= r:
                continue
            own = (i // W) * 9 * W + i % W
            u, z, q = three(rows, S, own), three(rows, S, own + 3 * W), spread(rows, Q[i])
            sums = zero, zero, zero
            stop = end - ((end - r) & rest)
            while r < stop:
                b = places_of(rows, row_offset, r)
                ask_ahead(row_offset, row_data, r, r * stride)
                if finite:
                    f, d = _stretched(rows, row_data, r, S, b, u, z, q, Q, weights, weighted, response, closed)
                else:
                    f, d = _pulled(rows, row_data, r, S, b, u, z, q, Q, weights, weighted)
                p = rounded(f, d, M)
                sums = added(sums, p)
                take_forces(S, b, p)
                r += step
            if rows > 1 and r < end:  # a row is left
                b1 = places_of(1, row_offset, r)
                u1, z1, q1, response1 = first_three(u), first_three(z), of_first(q), first_numbers(response)
                if finite:
                    f1, d1 = _stretched(1, row_data, r, S, b1, u1, z1, q1, Q, weights, weighted, response1, closed)
                else:
                    f1, d1 = _pulled(1, row_data, r, S, b1, u1, z1, q1, Q, weights, weighted)
                p1 = rounded(f1, d1, of_first(M))
                sums = added_first(rows, sums, p1)
                take_forces(S, b1, p1)
            add_own(SI, own, sums)
        return last

    return add_volumetric_forces


def _tangent_sweep(closed, weighted):
    """Build the sweep of the tangent, with ``phi`` in closed form or as a series, and with weights or without."""

    @njit(**_options)
    def add_tangent_forces(
        first, last, row_start, row_offset, row_data, S, SI, table, Q, weights, change, extremes
    ):  # fmt: skip
        """Add the change of the finite bond forces for a small change ``v`` of the displacements.

        Parameters are those of the sweep of the forces, with ``v`` in rows 0-2 of the table and deformed positions in
        rows 3-5.

        change : float64, shape (n_clusters * 4,)
            The change of ``q`` of all points.
        extremes : float64, shape (2,)
            The first is raised to the largest component of a bond's force.
        """
        zero = splat(0.0)
        numbers = numbers_of(1, table)
        M = held(1, table[V5])
        one = held(1, table[V6])
        peak = splat(extremes[0])
        for i in range(first, last):
            r = u8(row_start[i])
            end = u8(row_start[i + 1])
            if end <= r:
                continue
            c = i // W
            own = c * 9 * W + (i - c * W)
            ux = splat(S[own])
            uy = splat(S[own + W])
            uz = splat(S[own + 2 * W])
            zx = splat(S[own + 3 * W])
            zy = splat(S[own + 4 * W])
            zz = splat(S[own + 5 * W])
            q = splat(Q[i])
            more = splat(change[i])
            fx = zero
            fy = zero
            fz = zero
            while r < end:
                b = u8(row_offset[r])
                o = r * STEP
                ask_ahead(row_offset, row_data, r, o)
                r += ONE
                vx = load(S, b) - ux
                vy = load(S, b + V1) - uy
                vz = load(S, b + V2) - uz
                yx = load(S, b + V3) - zx
                yy = load(S, b + V4) - zy
                yz = load(S, b + V5) - zz
                inverse = load(row_data, o + V1)
                e = fma(yx, yx, fma(yy, yy, yz * yz)) * inverse - one
                phi = response_in_closed_form(one, e, numbers) if closed else response_by_series(one, e, numbers)
                common, changed = load(Q, b // _NINE), load(change, b // _NINE)
                if weighted:
                    here, there = load(weights, o), load(weights, o + V1)
                    common = q * here + common * there  # alike from both ends
                    changed = more * here + changed * there
                else:
                    common = q + common
                    changed = more + changed
                k = load(row_data, o)
                k = k + k
                shrink = one - phi
                along = (inverse * (one - common)) * (shrink * shrink) * fma(yx, vx, fma(yy, vy, yz * vz)) + changed
                along = (k * shrink) * along
                across = k * fma(shrink, common, phi)
                px = fma(across, vx, fma(along, yx, M))
                py = fma(across, vy, fma(along, yy, M))
                pz = fma(across, vz, fma(along, yz, M))
                peak = largest(magnitude(px - M), largest(magnitude(py - M), largest(magnitude(pz - M), peak)))
                fx = iadd(fx, px)
                fy = iadd(fy, py)
                fz = iadd(fz, pz)
                store(S, b + V6, isub(load(S, b + V6), px))
                store(S, b + V7, isub(load(S, b + V7), py))
                store(S, b + V8, isub(load(S, b + V8), pz))
            SI[own + 6 * W] += ihsum(fx)
            SI[own + 7 * W] += ihsum(fy)
            SI[own + 8 * W] += ihsum(fz)
        extremes[0] = hmax(peak)
        return last

    return add_tangent_forces


#: By (finite, series, weighted).
SWEEPS = {
    (True, True, False): force_sweep(finite=True, closed=False, weighted=False),
    (True, False, False): force_sweep(finite=True, closed=True, weighted=False, rows=1),
    (False, False, False): force_sweep(finite=False, closed=False, weighted=False),
    (True, True, True): force_sweep(finite=True, closed=False, weighted=True),
    (True, False, True): force_sweep(finite=True, closed=True, weighted=True, rows=1),
    (False, False, True): force_sweep(finite=False, closed=False, weighted=True),
}
#: By (series, weighted).
TANGENTS = {
    (True, False): _tangent_sweep(closed=False, weighted=False),
    (False, False): _tangent_sweep(closed=True, weighted=False),
    (True, True): _tangent_sweep(closed=False, weighted=True),
    (False, True): _tangent_sweep(closed=True, weighted=True),
}
#: What to call the sweeps: their functions share a name.
NAMES = {
    sweep: f"{'finite, ' + ('series' if series else 'closed form') if finite else 'linear'}, volumetric"
    for (finite, series, _), sweep in SWEEPS.items()
} | {sweep: f"tangent, {'series' if series else 'closed form'}, volumetric" for (series, _), sweep in TANGENTS.items()}

_f8, _i8, _int, _f4 = types.float64[::1], types.int64[::1], types.int64, types.float32[::1]
_forces = _int(_int, _int, _i8, types.uint32[::1], _f4, _f8, _i8, _f8, _f8, _f4)
_tangent = _int(_int, _int, _i8, types.uint32[::1], _f4, _f8, _i8, _f8, _f8, _f4, _f8, _f8)
SIGNATURES = dict.fromkeys(SWEEPS.values(), _forces) | dict.fromkeys(TANGENTS.values(), _tangent)
