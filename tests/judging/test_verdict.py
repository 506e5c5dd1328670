"""What is plainly unlike the asset is said to be, with the way out."""

import pytest

from mi_simplify.judging.verdict import larger, unlike


def figures(flip, silhouette_error):
    row = {"triangles": 300, "psnr": 20.0, "flip": flip, "silhouette_error": silhouette_error}
    return {"candidates": {"first guess": row | {"flip": 1.0}, "result": row}}


def test_a_good_result_gives_no_alarm():
    assert unlike(figures(0.05, 0.01)) is None


@pytest.mark.parametrize(
    ("flip", "silhouette_error", "reason"), [(0.3, 0.01, "FLIP 0.30"), (0.05, 0.15, "error 15.0%")]
)
def test_a_bad_one_names_the_reason_and_the_way_out(flip, silhouette_error, reason):
    line = unlike(figures(flip, silhouette_error))
    assert reason in line and "--triangles 600" in line and "\n" not in line
    assert line.count("above") == 1


def sizes(file="a.glb", **row):
    return {"file": file, "bytes": 1000, "vertices": 500, "texels": 4096, "materials": 2} | row


def test_what_is_larger_than_the_asset_is_said_with_the_option_that_mends_it():
    def lines(reference, result):
        return larger({"reference": reference, "candidates": {"result": result}})

    assert not lines(sizes(), sizes(bytes=999))
    grown = lines(sizes(), sizes(bytes=3000, vertices=501, texels=8192))
    assert [line.split(":")[0] for line in grown] == [
        "the result has 3,000 bytes, more than the asset's 1,000",
        "the result has 501 vertices, more than the asset's 500",
        "the result has 8,192 texels, more than the asset's 4,096",
    ]
    assert "--textures webp" in grown[0] and "--triangles" in grown[1] and "initial.atlas_size" in grown[2]
    assert not lines(sizes("a.obj"), sizes(bytes=3000)), "an OBJ file is without its images"
    assert not lines(sizes(texels=2), sizes(texels=8192)), "an asset without textures"
    assert not lines(sizes(None, bytes=None), sizes())
