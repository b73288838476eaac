"""The picture of a deck: a long body and long names end within the picture, alone and beside the ranks."""

import numpy as np
import pytest
from PIL import Image

from pdfem_mpi.mesh.generators import box
from pdfem_mpi.results.sketch import SIZE, Sketch, draw_sketch


@pytest.mark.parametrize("ranks", [None, 3])
def test_body_and_legend_end_within_each_panel(tmp_path, ranks):
    pytest.importorskip("pyvista")
    mesh = box((0.0, 0.0, 0.0), (24.0, 3.0, 2.0), (24, 3, 2))
    place = mesh.centroids[:, 0]
    sketch = Sketch(
        corners=mesh.nodes[mesh.cells],
        region=(place > 12.0).astype(np.int64),
        names=("elements beyond the middle (finite elements)", "bonds (peridynamics)"),
        marks={"supports": np.zeros((1, 3))},
        places=np.empty((0, 3)),
        forces=np.empty((0, 3)),
        cracks=(),
        rank=None if ranks is None else (place // (24.0 / ranks)).astype(np.int32),
    )
    path = tmp_path / "check.png"
    draw_sketch(path, sketch, "a long bar")
    with Image.open(path) as picture:
        dark = np.asarray(picture.convert("L")) < 250
    panels = np.split(dark, dark.shape[1] // SIZE[0], axis=1)
    assert len(panels) == (1 if ranks is None else 2)
    for panel in panels:  # a line parts the two
        assert not panel[40:-10, 4:14].any() and not panel[10:-10, -14:-4].any()
        assert panel[40:-10, 14:-14].any()
