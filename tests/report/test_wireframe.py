"""Lines of a mesh over a picture."""

import numpy as np
from PIL import Image

from mi_simplify.model.asset import Asset, Instance, Part
from mi_simplify.report.wireframe import wireframe
from mi_simplify.scenes.views import look_at


def test_edges_of_faces_that_face_the_camera_are_drawn_where_they_are():
    square = np.float64([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    view = look_at([[0, 0, 4]], [0, 0, 0], [[0, 0, 4]], width=100, height=100, fov=2 * np.degrees(np.arctan(0.5)))
    black = Image.new("RGB", (100, 100))
    image = np.asarray(wireframe(Asset((Part(square, faces),), (Instance(0),)), view, black)).max(2) > 0
    rows, columns = np.flatnonzero(image.any(1)), np.flatnonzero(image.any(0))
    assert (rows[0], rows[-1], columns[0], columns[-1]) == (25, 75, 25, 75)  # a side of 2 in a film of 4
    assert image[75, 26] and image[40, 60] != image[60, 60]  # one diagonal, not the other
    hidden = wireframe(Asset((Part(square, faces[:, ::-1]),), (Instance(0),)), view, black)
    assert not np.asarray(hidden).any()
