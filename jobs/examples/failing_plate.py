"""Pull a cracked plate apart, one event at a time, and plot its damage where half of its strength is gone.

Type ``python jobs/examples/failing_plate.py`` (a few seconds).
"""

from pathlib import Path

import matplotlib.pyplot as plt

import pdfem_mpi as pdfem

JOBS = Path(__file__).resolve().parents[1]


def main():
    scene = pdfem.read_deck(
        JOBS / "plate_centre_crack.toml",
        {"mesh.lower": [-1.6, -1.6, -0.05], "mesh.upper": [1.6, 1.6, 0.05]}  # one cell thick
        | {"stepping.control": "load", "output.damage": True},
    )
    simulation = pdfem.Simulation(scene)
    peak = 0.0
    for row in simulation.steps():
        print(f"{row['event']:<8} load {row['load_factor']:.4f}  reaction {row['reaction']:8.1f} lbf  "
              f"{row['broken_bonds']:,} bonds broken")  # fmt: skip
        peak = max(peak, row["reaction"])
        if row["reaction"] < 0.5 * peak:
            break  # half of the strength is gone
    damage = simulation.damage()
    if damage is None:
        return  # gathered on rank 0
    figure, axes = plt.subplots(layout="constrained")
    places = simulation.points
    dots = axes.scatter(places[:, 0], places[:, 1], c=damage, s=2, cmap="magma_r", vmin=0.0, vmax=0.5)
    axes.set(aspect="equal", xlabel="x (in)", ylabel="y (in)", title=f"Centre-cracked plate, peak {peak:,.0f} lbf")
    figure.colorbar(dots, label="local damage (eq. 5)")
    figure.savefig("failing_plate.png", dpi=150)
    print("failing_plate.png: damage after the peak")


if __name__ == "__main__":
    main()
