"""What is plainly unlike the asset is said to be, with the way out."""

import pytest

from mi_simplify.judging.verdict import unlike


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
