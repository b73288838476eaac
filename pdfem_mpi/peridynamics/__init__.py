"""Bonds: points, rows, corrections, failure, damage."""
