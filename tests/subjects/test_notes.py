"""What a file loses is told on the terminal, whatever the command."""

import logging

from support.tiny_models import Glb

from mi_simplify.subjects import open_asset


def test_notes_of_a_file_are_warnings(tmp_path, caplog):
    glb = Glb()
    glb.mesh(glb.quad(glb.material(name="paint")))
    glb.json["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}] * 2
    with caplog.at_level(logging.WARNING, logger="mi_simplify"):
        open_asset(glb.save(tmp_path / "room.glb"))
    assert caplog.messages == ["room.glb: 2 cameras were left out"]
