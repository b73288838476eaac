# pdfem_mpi with MPICH, pyvista and compiled kernels:
#
#   docker build -t pdfem .
#   docker run --rm -v "$PWD:/work" pdfem init bar && docker run --rm -v "$PWD:/work" pdfem run bar.toml -n 2
#
# The kernels are compiled for the processor that builds the image; another kind compiles its own, once in each container.
FROM python:3.11-slim

RUN apt-get update && apt-get install -y --no-install-recommends libgl1 libegl1 libxrender1 && rm -rf /var/lib/apt/lists/*

COPY constraints.txt pyproject.toml README.md LICENSE /src/
COPY pdfem_mpi /src/pdfem_mpi
RUN pip install --no-cache-dir -c /src/constraints.txt "/src[mpich,viz]"

ENV NUMBA_CACHE_DIR=/var/cache/pdfem
RUN mkdir -p /var/cache/pdfem && pdfem warmup && chmod -R a+rwX /var/cache/pdfem

WORKDIR /work
ENTRYPOINT ["pdfem"]
CMD ["--help"]
