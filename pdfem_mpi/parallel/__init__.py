"""The part of the program that knows ranks: communicator, ownership of cells, halo."""
