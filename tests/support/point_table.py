"""The table of points as sweeps find it."""

import numpy as np

from pdfem_mpi.kernels.point_table import start_evaluation


def reset_forces(SI, excess, pattern_bits):
    """Start the integer forces as an evaluation does, and leave the displacements; parameters as there."""
    start_evaluation(np.empty(0), np.empty(0), SI.view(np.float64), SI, False, excess, pattern_bits)
