"""Fitted bond factors: one symmetric factor a bond, with which every uniform strain is an equilibrium."""
