"""What a fit of the bond factors reached."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Fit:
    """What a fit reached; all numbers are those of the whole body.

    Attributes
    ----------
    signs : "free" or "bounded"
    sweeps : int
        Over the bonds, preparations included.
    turns : int
        Linear solves: 1 with free signs.
    residual, residual_in_slack : float, dimension 1
        Largest miss of a point's ten moments, relative to the largest target, outside and inside the slack.
    residual_rms, residual_rms_in_slack : float, dimension 1
        Root of the mean of the squares.
    residual_of_bodies : tuple of float, dimension 1
        Largest miss of each body, slack included.
    slack_points : int
    smallest_factor, largest_factor : float
    share_at_bound : float
        Bonds whose factor is 0, among all.
    compatibility_change : float
        Relative change of the area vectors.
    """

    signs: str
    sweeps: int
    turns: int
    residual: float
    residual_in_slack: float
    residual_rms: float
    residual_rms_in_slack: float
    residual_of_bodies: tuple[float, ...]
    slack_points: int
    smallest_factor: float
    largest_factor: float
    share_at_bound: float
    compatibility_change: float
