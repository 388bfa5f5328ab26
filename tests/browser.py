"""For the tests of pages: a browser without a screen (they are skipped where there is none), and what a notebook would show."""

import shutil

import pytest

from particles_mpi import Scene, Simulation
from particles_mpi.results import notebook

NAMES = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")


def start_browser():
    """Yields a function that opens a file offline and returns its page, which fails the test for any message in the console."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = next((path for name in NAMES if (path := shutil.which(name))), None)
    if program is None:
        pytest.skip(f"no browser: none of {', '.join(NAMES)} is installed")
    said = []
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=OPTIONS)
        context = browser.new_context(viewport={"width": 1200, "height": 800}, offline=True)

        def open_page(path):
            page = context.new_page()
            page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
            page.on("pageerror", lambda error: said.append(str(error)))
            page.on("request", lambda request: None if request.url.startswith(("file:", "data:")) else said.append(request.url))
            page.goto(path.resolve().as_uri())
            page.wait_for_selector("body[data-ready]")
            return page

        open_page.said = said
        yield open_page
        browser.close()


class Recorder:
    """Stands for IPython.display: keeps what is shown at each place."""

    def __init__(self):
        self.places = []

    def HTML(self, text):
        return text

    def display(self, what, display_id):
        self.places.append([what])
        return self

    def update(self, what):
        self.places[isinstance(what, str)].append(what)


def shown_simulation(monkeypatch):
    """For a fixture. What a simulation shows that is looked at while it runs: [pages, messages]."""
    recorder = Recorder()
    monkeypatch.setattr(notebook, "_display", lambda: recorder)
    monkeypatch.setattr(notebook, "SENDING_PAUSE", 0.0)
    sim = Simulation(Scene(dimension=2, time={"step": 0.1, "steps": 8}, box={"lower": [0, 0], "upper": [4, 4]},
                           particles=[{"position": [[1, 1], [3, 3]], "velocity": [[1, 0], [0, -0.5]], "radius": 0.2}],
                           effects={"walls": {}, "drag": {"rate": -0.0}}, output={"every": 2}))  # fmt: skip
    sim.view()
    for _ in range(3):
        sim.step()
    sim.add({"position": [[2, 2]], "velocity": [3, 0], "radius": 0.1})
    sim.run()
    return recorder.places
