"""One run: from a scene to a run folder, and back from a checkpoint."""
