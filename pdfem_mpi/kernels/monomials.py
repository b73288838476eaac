"""The ten monomials of degree three, by which the fit of bond factors names a point's moments, and their products."""

import numpy as np

#: Moments a point.
N = 10
#: Exponents of x, y and z of the ten monomials.
MONOMIALS = np.array([(a, b, 3 - a - b) for a in range(3, -1, -1) for b in range(3 - a, -1, -1)])
#: How often each occurs in a symmetric tensor of rank 3.
MULTIPLICITY = np.array([1.0, 3.0, 3.0, 3.0, 6.0, 3.0, 1.0, 3.0, 3.0, 1.0])


def _place(exponents):
    """Place of a product of two monomials among the sums of `bond_moments.add_blocks`, ten of each part."""
    if max(exponents) < 3:
        return N
    part = next(d for d in range(3) if exponents[d] >= 3)
    rest = tuple(e - 3 * (d == part) for d, e in enumerate(exponents))
    return N * part + MONOMIALS.tolist().index(list(rest))


#: Place of each entry of a point's block among those sums, and how often the entry counts.
BLOCK_ENTRIES = np.array([[_place(tuple((a + b).tolist())) for b in MONOMIALS] for a in MONOMIALS])
BLOCK_SCALES = np.sqrt(np.outer(MULTIPLICITY, MULTIPLICITY))
