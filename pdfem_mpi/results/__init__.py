"""Result files of a run, written by rank 0 from plain arrays in the units of the deck; no MPI here."""
