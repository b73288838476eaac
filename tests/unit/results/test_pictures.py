"""Pictures in three dimensions: a crack inside a thick body is seen, and bad input is a sentence."""

import builtins

import numpy as np
import pytest
from PIL import Image

from pdfem_mpi.results import vtkhdf
from pdfem_mpi.results.pictures import View, _section, _settled, draw_body, draw_film, load_pyvista
from pdfem_mpi.results.whole_body import Body, NoPicture, nice_factor

CELLS = 6
GAUSS = 0.5 + np.array([(r, s, t) for t in (-1, 1) for s in (-1, 1) for r in (-1, 1)]) / (2.0 * np.sqrt(3.0))
OPENING = 0.02


def cube(folder, frames=2, inside=True, damage=True):
    """A cube of unit cells with a crack across x: in its middle, or through all of it."""
    corners = np.stack(np.meshgrid(*3 * [np.arange(CELLS)], indexing="ij"), axis=-1).reshape(-1, 3)
    x = (corners[:, None, :] + GAUSS).reshape(-1, 3)
    cells = np.repeat(corners, 8, axis=0)
    beside = (cells[:, 0] >= CELLS // 2 - 1) & (cells[:, 0] <= CELLS // 2)
    if inside:
        beside &= ((cells[:, 1:] >= 2) & (cells[:, 1:] < CELLS - 2)).all(axis=1)
    vtkhdf.create_points(folder / "points.vtkhdf", x, {"overlap": np.zeros(len(x), bool)})
    for frame in range(frames):
        u = 1e-3 * (frame + 1) * (x - CELLS / 2)
        u[:, 0] += np.where(beside, OPENING * np.sign(x[:, 0] - CELLS / 2), 0.0)
        fields = {"displacement": u} | ({"damage": np.where(beside, 0.4, 0.0)} if damage else {})
        numbers = {"load_factor": 0.5 * (frame + 1), "reaction": 1.0, "broken_bonds": 10.0}
        vtkhdf.append_frame(folder / "points.vtkhdf", frame + 1.0, fields, field_data=numbers)
    return Body(folder)


def test_cells_are_the_cubes_they_were_made_of(tmp_path):
    body = cube(tmp_path)
    assert body.corners.shape == (CELLS**3, 8, 3)
    np.testing.assert_allclose(np.ptp(body.corners, axis=1), 1.0, rtol=1e-12)
    assert body.corners.min() == pytest.approx(0.0, abs=1e-12) and body.corners.max() == pytest.approx(CELLS)


def test_neighbours_move_apart_at_a_crack_and_together_elsewhere(tmp_path):
    body = cube(tmp_path, inside=False)
    moved = body.corners + body.displacement(-1)
    centre = body.corners.mean(axis=1)
    left, right = (moved[np.abs(centre[:, 0] - place) < 0.1] for place in (2.5, 3.5))
    gap = right[:, :, 0].min() - left[:, :, 0].max()
    assert gap > 1.5 * OPENING
    first, second = (moved[np.abs(centre[:, 0] - place) < 0.1] for place in (0.5, 1.5))
    assert second[:, :, 0].min() == pytest.approx(first[:, :, 0].max(), abs=1e-6)


def test_a_crack_inside_is_cut_open(tmp_path):
    body = cube(tmp_path)
    section = _section(body, _settled(body, View()))
    assert section.axis in (1, 2) and 2.0 < section.place < CELLS - 2.0
    assert _section(body, _settled(body, View(section=False))) is None


def test_a_crack_that_is_seen_from_outside_is_not(tmp_path):
    body = cube(tmp_path, inside=False)
    assert _section(body, _settled(body, View())) is None
    assert _section(body, _settled(body, View(section=True))) is not None


def test_fields_and_their_names(tmp_path):
    body = cube(tmp_path)
    assert body.names == ["damage", "displacement"]
    size, component = body.field("displacement", -1), body.field("displacement_y", -1)
    assert size.shape == (CELLS**3,) and (size >= np.abs(component) - 1e-12).all()
    with pytest.raises(NoPicture, match=r"no field stress.*damage, displacement.*output\.damage = true"):
        body.field("stress", 0)


def test_the_factor_is_a_round_number(tmp_path):
    body = cube(tmp_path)
    factor = nice_factor(body, body.displacement(0))
    assert factor == 10.0  # 0.0225 of 6 at most, and 5 % wanted
    assert nice_factor(body, 1e3 * body.displacement(0)) == 1.0


@pytest.mark.parametrize(
    ("view", "words"),
    [(View(frame=2), "has no frame 2: they count from 0 to 1"), (View(field="stress"), "have no field stress")],
)
def test_bad_input_is_a_sentence(tmp_path, view, words):
    with pytest.raises(NoPicture, match=words):
        _settled(cube(tmp_path), view)


def test_nothing_to_draw_is_a_sentence(tmp_path):
    with pytest.raises(NoPicture, match="has no fields to draw"):
        Body(tmp_path)
    vtkhdf.create_points(tmp_path / "points.vtkhdf", np.zeros((8, 3)))
    with pytest.raises(NoPicture, match="has no frame yet"):
        Body(tmp_path)


def test_without_pyvista_the_sentence_names_it(monkeypatch):
    real = builtins.__import__

    def without(name, *arguments, **more):
        if name == "pyvista":
            raise ModuleNotFoundError("No module named 'pyvista'", name="pyvista")
        return real(name, *arguments, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(NoPicture, match="pip install pyvista"):
        load_pyvista()


def test_a_film_of_one_frame_is_a_sentence(tmp_path):
    with pytest.raises(NoPicture, match="has one frame, which is no film"):
        draw_film(tmp_path / "body.gif", cube(tmp_path, frames=1), View())


def test_the_picture_shows_the_crack(tmp_path):
    """Dark pixels stand in the middle of the picture of a body whose outside is bright."""
    words = draw_body(tmp_path / "body.png", cube(tmp_path), View(), "a cube", "mm")
    assert "cut at" in words and "10 broken bonds" in words
    picture = np.asarray(Image.open(tmp_path / "body.png").convert("RGB")).astype(int)
    height, width = picture.shape[:2]
    middle = picture[height // 3 : 2 * height // 3, width // 3 : 2 * width // 3]
    crack = (
        (middle[:, :, 0] - middle[:, :, 1] > 40) & (middle[:, :, 2] > middle[:, :, 1] - 40) & (middle.sum(axis=2) < 400)
    )
    assert 0.02 < crack.mean() < 0.6


@pytest.mark.slow
def test_a_film_has_all_frames(tmp_path):
    told = []
    draw_film(tmp_path / "body.gif", cube(tmp_path), View(), told=lambda *numbers: told.append(numbers))
    with Image.open(tmp_path / "body.gif") as film:
        assert film.n_frames == 2
    assert told == [(1, 2), (2, 2)]
