"""The computer: launcher, environment, signals, files, memory."""
