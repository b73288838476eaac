"""Studies: one deck run with several values of some keys, into one folder with one table and one figure."""
