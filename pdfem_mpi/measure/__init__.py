"""What is read off a solution: fields of the whole body, probes."""
