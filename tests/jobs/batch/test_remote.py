"""Models behind addresses, on a local server: fetched, told apart by what the server says, one line for what is not."""

import sys
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import pytest
from support.toy import bumpy_sphere

from mi_simplify.errors import AssetError, RuntimeUnavailable
from mi_simplify.jobs.batch import work
from mi_simplify.jobs.batch.entries import Entry, read_entries
from mi_simplify.jobs.batch.remote import fetched

pytest.importorskip("fsspec.implementations.http", reason="the extra [urls]")


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *args) -> None:
        pass


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """A folder, and the address by which a server has its files."""
    folder = tmp_path_factory.mktemp("served")
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield folder, f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()
    thread.join()


def test_addresses_stand_in_sources_and_manifests(served, tmp_path):
    _, address = served
    (tmp_path / "list.yaml").write_text(f"assets: ['{address}/far/chair.glb?key=1', near.ply]")
    entries = read_entries([f"{address}/my%20lamp.glb", str(tmp_path / "list.yaml")], [], {})
    assert [e.name for e in entries] == ["my_lamp", "chair", "near"]
    assert entries[1].asset == f"{address}/far/chair.glb?key=1"  # not relative to the manifest


def test_a_file_is_fetched_and_a_new_version_is_another(served, tmp_path):
    folder, address = served
    path = bumpy_sphere(folder, 4)
    entry = Entry(asset=f"{address}/{path.name}", name="a")
    assert fetched(entry.asset, tmp_path / "copies").read_bytes() == path.read_bytes()
    before = entry.fingerprint()
    assert before == entry.fingerprint()
    path.write_text(path.read_text() + "\n")
    assert entry.fingerprint() != before


def test_what_cannot_be_fetched_fails_alone(served, tmp_path):
    _, address = served
    for url in (f"{address}/none.glb", "http://127.0.0.1:1/none.glb"):
        ended = work.work(Entry(asset=url, name="none"), "f", str(tmp_path), work.Limits())
        assert ended.code == 2 and ended.line.startswith(f"{url}: cannot be fetched") and "\n" not in ended.line
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("https://example.com/spot.obj", "only files that hold all of a model are fetched: .glb"),
        ("gopher://example.com/spot.glb", "Protocol not known: gopher"),
    ],
)
def test_addresses_that_are_of_no_use(url, message):
    with pytest.raises(AssetError, match=message):
        read_entries([url], [], {})


def test_without_fsspec_a_line_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(RuntimeUnavailable, match=r"needs fsspec: pip install 'mi-simplify\[urls\]'"):
        read_entries(["https://example.com/spot.glb"], [], {})


@pytest.mark.slow
def test_a_result_of_an_address_is_that_of_its_file(served, tmp_path):
    folder, address = served
    path = bumpy_sphere(folder, 10)
    settings = {"optimizer.steps": 0, "initial.atlas_size": 64, "evaluation.views": 1, "evaluation.resolution": 32}
    ended = [
        work.work(Entry(asset=asset, name=name, triangles="60", set=settings), "f", str(tmp_path), work.Limits())
        for name, asset in (("near", str(path)), ("far", f"{address}/{path.name}"))
    ]
    assert [outcome.code for outcome in ended] == [0, 0], ended
    assert len({(tmp_path / name / "model.glb").read_bytes() for name in ("near", "far")}) == 1
    assert not list(tmp_path.glob(".fetched*"))
