"""OFF, 3MF and Collada through trimesh: positions, colours and placements as they were written."""

import logging

import numpy as np
import pytest
import trimesh

from mi_simplify.errors import AssetError
from mi_simplify.formats.load import load_asset
from mi_simplify.model.color import srgb_to_linear


def test_off_with_colours_of_vertices(tmp_path):
    path = tmp_path / "tetrahedron.off"
    path.write_text("OFF\n4 4 6\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n")
    (part,) = load_asset(path).parts
    assert part.vertices.shape == (4, 3) and part.faces.tolist() == [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]


def test_face_colours_are_linear_and_split_the_vertices(tmp_path):
    from mi_simplify.formats.exchange.by_trimesh import _part

    box = trimesh.creation.box()
    box.visual.face_colors = np.tile(np.uint8([255, 128, 0, 255]), (12, 1))
    part = _part("box", box)
    assert part.vertices.shape == (36, 3) and part.colors is not None
    np.testing.assert_allclose(part.colors[0], [*srgb_to_linear(np.array([1, 128 / 255, 0])), 1], atol=1e-6)


@pytest.mark.parametrize("text", ["OFF\n", "OFF\n3 1 0\n0 0 0\n", "no off at all"])
def test_what_trimesh_cannot_read_is_one_line(text, tmp_path):
    path = tmp_path / "broken.off"
    path.write_text(text)
    with pytest.raises(AssetError, match="broken.off: trimesh (cannot read it|finds no triangles)") as caught:
        load_asset(path)
    assert "\n" not in str(caught.value)


def test_what_trimesh_warns_of_is_a_note_and_not_printed(tmp_path, monkeypatch, capfd):
    load = trimesh.load

    def warning(*args, **kwargs):
        logging.getLogger("trimesh").warning("id 1 included\nbut not defined!")
        return load(*args, **kwargs)

    monkeypatch.setattr(trimesh, "load", warning)
    trimesh.creation.box().export(tmp_path / "box.off")
    assert load_asset(tmp_path / "box.off").notes == ("trimesh: id 1 included but not defined!",)
    assert capfd.readouterr() == ("", "") and not logging.getLogger("trimesh").handlers
