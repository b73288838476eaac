"""Reporters for runs in tests: one that says nothing, and one that keeps what it is told."""


class Silence:
    """A reporter that says nothing."""

    def line(self, text):
        """Say nothing."""

    def progress(self, *arguments):
        """Say nothing."""

    def row(self, columns):
        """Say nothing."""

    def table(self, title, rows):
        """Say nothing."""


class Listener(Silence):
    """A reporter that keeps the lines."""

    def __init__(self):
        self.lines = []

    def line(self, text):
        """Keep a line."""
        self.lines.append(text)

    def said(self, *parts):
        """Whether one line has all these parts."""
        return any(all(part in line for part in parts) for line in self.lines)
