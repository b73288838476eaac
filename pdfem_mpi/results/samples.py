"""What figures of probes are drawn from; matplotlib is not needed to make it."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class BarStations:
    """Displacements along a bar, beside those of the exact uniform stretch.

    Attributes
    ----------
    coordinate : float, shape (n,), dimension length
        Places along the axis, in any order.
    displacement, exact : float, shape (n,), dimension length
        Displacements along the axis: the computed ones and those of the exact solution.
    kind : str, shape (n,)
        "finite elements" or "peridynamics": where the computed displacement was taken from.
    interface : float or None, dimension length
        Where the finite-element and the peridynamic part meet; None if the bar has one part only.
    overlap : (float, float) or None, dimension length
        Ends of the layer of cells in which both descriptions live.
    axis : "x", "y" or "z"
    """

    coordinate: np.ndarray
    displacement: np.ndarray
    exact: np.ndarray
    kind: np.ndarray
    interface: float | None = None
    overlap: tuple[float, float] | None = None
    axis: str = "x"

    @property
    def error_percent(self) -> np.ndarray:
        """Computed minus exact displacement, in percent of the largest exact one; float, shape (n,).

        Raises
        ------
        ValueError
            The exact displacement is zero everywhere, so nothing is left to compare with.
        """
        end = np.max(np.abs(self.exact))
        if end == 0.0:
            raise ValueError("the exact displacement of the bar is zero at every station: is its stress zero?")
        return 100.0 * (np.asarray(self.displacement) - self.exact) / end


@dataclass(frozen=True)
class LineSamples:
    """Displacements along a line through the body.

    Attributes
    ----------
    coordinate : float, shape (n,), dimension length
        Places along the line.
    displacement : float, shape (n, 2), dimension length
        Components u_x and u_y; NaN outside of the body.
    kind : str, shape (n,)
        "finite elements", "peridynamics", or "" outside of the body.
    along : str
        What the coordinate is, for the axis: "x", "y" or "z", or words.
    where : str
        Where the line is, under the title.
    """

    coordinate: np.ndarray
    displacement: np.ndarray
    kind: np.ndarray
    along: str
    where: str
