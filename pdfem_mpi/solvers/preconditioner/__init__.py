"""The preconditioner of conjugate gradients."""
