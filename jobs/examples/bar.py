"""Solve the coupled bar of section 4.1 and plot its axial displacement over the exact one.

Type ``python jobs/examples/bar.py`` (one rank, a few seconds), or ``mpirun -n 2 python jobs/examples/bar.py``.
"""

from pathlib import Path

import matplotlib.pyplot as plt

import pdfem_mpi as pdfem

JOBS = Path(__file__).resolve().parents[1]
STRAIN = 1.0e-3  # 10,000 psi over 10 million psi


def main():
    scene = pdfem.read_deck(JOBS / "bar_exact.toml", {"mesh.spacing": 0.1})
    simulation = pdfem.Simulation(scene)
    for row in simulation.steps():
        residual = row["relative_residual"]
    fields = simulation.fields()
    if fields is None:
        return  # fields are gathered on rank 0
    print(f"residual {residual:.1e} of the load, {len(simulation.points):,} points, {len(simulation.nodes):,} nodes")
    figure, axes = plt.subplots(layout="constrained")
    axes.plot(simulation.nodes[:, 0], fields.u_nodes[:, 0], ".", label="nodes of finite elements")
    axes.plot(simulation.points[:, 0], fields.u_points[:, 0], ".", label="peridynamic points")
    ends = simulation.nodes[:, 0].min(), simulation.points[:, 0].max()
    middle = fields.u_nodes[:, 0][abs(simulation.nodes[:, 0]) < 1e-9].mean()
    axes.plot(ends, [middle + STRAIN * x for x in ends], "k-", linewidth=1, label="exact")
    axes.set(xlabel="x (in)", ylabel="axial displacement (in)", title="A bar, half elements, half peridynamics")
    axes.legend()
    figure.savefig("bar.png", dpi=150)
    print("bar.png: axial displacement")


if __name__ == "__main__":
    main()
