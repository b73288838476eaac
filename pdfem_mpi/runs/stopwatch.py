"""Seconds of the phases of a run."""

from time import perf_counter


class phase:
    """Adds the time spent inside to an entry."""

    def __init__(self, seconds: dict[str, float], name: str):
        self.seconds, self.name = seconds, name

    def __enter__(self):
        self.start = perf_counter()

    def __exit__(self, *exception):
        self.seconds[self.name] = self.seconds.get(self.name, 0.0) + perf_counter() - self.start
