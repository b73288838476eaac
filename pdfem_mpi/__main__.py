"""``python -m pdfem_mpi`` is the console command ``pdfem``."""

from pdfem_mpi.command.launching import main

if __name__ == "__main__":
    main()
