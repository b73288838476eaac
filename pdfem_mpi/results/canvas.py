"""What figures need of matplotlib, loaded in two thirds of its time.

matplotlib writes a list of all properties into the docstring of each kind of artist while it is loaded. Figures at the
end of a run are waited for, and nobody reads these docstrings there.
"""

import matplotlib.artist

_list_properties = matplotlib.artist.kwdoc
matplotlib.artist.kwdoc = lambda artist: ""
try:
    from matplotlib import rc_context
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator
finally:
    matplotlib.artist.kwdoc = _list_properties

__all__ = ["Axes", "Figure", "MaxNLocator", "Normalize", "rc_context"]
