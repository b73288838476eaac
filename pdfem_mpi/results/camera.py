"""From where a body is seen in pictures of three dimensions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

#: From where a view looks, and what is up in it; x, y and z look from the upper ends of the axes.
CAMERAS = {
    "iso": ((1.0, -1.4, 0.9), (0.0, 0.0, 1.0)),
    "x": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "y": ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "z": ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
}
VIEWS = tuple(CAMERAS)
#: Shares of a picture's height for the words above and for the scale below.
ABOVE, BELOW = 0.09, 0.17


def look(plotter: Any, view: str, bounds: Sequence[float], below: float = BELOW) -> None:
    """Place the camera: parallel rays, the body between the words above and what is below, a share of the height."""
    towards, up = CAMERAS[view]
    left, bottom, end, top = plotter.renderer.viewport  # of several panels the one that is drawn
    size = plotter.window_size[0] * (end - left), plotter.window_size[1] * (top - bottom)
    towards, up = np.array(towards, float), np.array(up, float)
    towards /= np.linalg.norm(towards)
    right = np.cross(up, towards)
    right /= np.linalg.norm(right)
    upright = np.cross(towards, right)
    low, high = np.array(bounds[0::2]), np.array(bounds[1::2])
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    width, height = np.ptp(corners @ right), np.ptp(corners @ upright)
    whole = max(height / (1.0 - ABOVE - below), width / (0.94 * size[0] / size[1]), 1e-300)
    centre = 0.5 * (low + high) - 0.5 * (below - ABOVE) * whole * upright
    plotter.camera.parallel_projection = True
    plotter.camera.focal_point = centre
    plotter.camera.position = centre + 4.0 * max(np.linalg.norm(high - low), 1e-300) * towards
    plotter.camera.up = upright
    plotter.camera.parallel_scale = 0.5 * whole
    plotter.reset_camera_clipping_range()
