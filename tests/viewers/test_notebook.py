"""What a notebook shows: the tour runs from first cell to last, and a page gets the frames of a simulation that goes on."""

import html
import json
import re

import pytest
from browser import shown_simulation
from conftest import ROOT

from particles_mpi import Run, Scene, SceneError, Simulation


def frames_in(shown):
    """How many frames the page in a frame of HTML has."""
    page = html.unescape(re.search(r'srcdoc="([^"]*)"', shown)[1])
    return len(json.loads(re.search(r'id="frames"[^>]*>(.*?)</script>', page, re.S)[1]))


@pytest.mark.filterwarnings("ignore")  # of Jupyter, about itself
def test_the_tour(tmp_path):
    nbclient, nbformat = (pytest.importorskip(name) for name in ("nbclient", "nbformat"))
    tour = nbformat.read(ROOT / "python_viz" / "tour.ipynb", 4)
    cells = [cell for cell in tour.cells if cell.cell_type == "code"]
    assert len(cells) == 10 and not any(cell.outputs for cell in cells)
    nbclient.NotebookClient(tour, timeout=300, iopub_timeout=60, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in cells for output in cell.outputs]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 4
    shown = next(output.data["text/html"] for output in outputs if "iframe" in output.get("data", {}).get("text/html", ""))
    assert frames_in(shown) == 101
    leapfrog, order4 = map(float, re.findall(r"\d\.\d+", outputs[-1].text))
    assert leapfrog == pytest.approx(2.0, abs=0.1) and order4 == pytest.approx(4.0, abs=0.25)


shown = pytest.fixture(shown_simulation)


def test_a_page_gets_the_frames_of_a_simulation(shown):
    pages, messages = shown
    assert [frames_in(page._repr_html_()) for page in pages] == [1, 5]
    told = [json.loads(re.search(r"postMessage\((.*), '\*'\)", message)[1]) for message in messages if message]
    assert [frame["number"] for message in told for frame in message["frames"]] == [1, 2, 3, 4]
    assert told[-1]["ranges"]["speed"][1] == pytest.approx(3.0, rel=0.02)
    assert told[-1]["curves"][0]["time"] == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8])


def test_outside_a_notebook_view_says_what_to_do(tmp_path):
    sim = Simulation(Scene(dimension=2, time={"step": 0.1, "steps": 1}, particles=[{"position": [[0, 0]]}]))
    with pytest.raises(SceneError, match=r"only in a notebook; elsewhere .* particles-mpi view FOLDER"):
        sim.view()
    assert not sim.views
    sim.run(tmp_path / "run")
    assert frames_in(Run(tmp_path / "run").view()._repr_html_()) == 2
