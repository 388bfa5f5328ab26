"""The page of a run in a real browser: it loads without a network, shows what is there, plays, and lets one choose."""

import io

import numpy as np
import pytest
from browser import shown_simulation, start_browser
from matplotlib import colormaps, image

from particles_mpi import Run, Scene, Simulation
from particles_mpi.results.page import DARKEST, write_page

browser = pytest.fixture(scope="module")(start_browser)
shown = pytest.fixture(shown_simulation)


@pytest.fixture
def opened(browser):
    """Opens the page of a run; nothing may have been said in the console, nor asked of a network, when the test ends."""
    pages = []

    def open_run(folder):
        pages.append(browser(write_page(Run(folder))))
        return pages[-1]

    yield open_run
    said = list(browser.said)
    browser.said.clear()
    for page in pages:
        page.close()
    assert not said


LEAST_ALPHA = """() => {
  const {gl} = spheres, {width, height} = canvas, pixels = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  return pixels.reduce((least, value, k) => k % 4 === 3 ? Math.min(least, value) : least, 255);
}"""


def ran(folder, **scene):
    Simulation(Scene(**scene)).run(folder)
    return folder


def drawn(page):
    """The picture of the stage, (height, width, 3) from 0 to 1, without what is written on it."""
    page.evaluate(
        "document.querySelectorAll('#over, #heading, #scale, #picked').forEach(e => { e.style.visibility = 'hidden'; })"
    )
    shot = page.locator("#stage").screenshot()
    page.evaluate("document.querySelectorAll('#over, #heading, #scale, #picked').forEach(e => { e.style.visibility = ''; })")
    return image.imread(io.BytesIO(shot))[..., :3]


def coloured(picture):
    """Pixels that are not grey, as those of ground and box are."""
    return np.ptp(picture, axis=2) > 0.12


SPACE = {
    "dimension": 3,
    "box": {"lower": [0, 0, 0], "upper": [4, 4, 4], "periodic": [True, False, False]},
    "time": {"step": 0.1, "steps": 12},
    "particles": [
        {
            "count": 200,
            "position": "random",
            "velocity": {"speed": 1.0},
            "radius": 0.1,
            "mass": {"min": 1.0, "max": 2.0},
            "drag": 0.5,
        },
        {"position": [[2.0, 2.0, 2.0]], "radius": 0.5, "fixed": True},
    ],
    "effects": {
        "collisions": {},
        "drag": {"rate": 0.1},
        "walls": {"planes": [{"point": [0, 0, 0.3], "normal": [0, 0.2, 1]}, {"point": [0, 0, 4], "normal": [0, 0, -1]}]},
    },
    "output": {"every": 1, "diagnostics_every": 1},
}


@pytest.fixture(scope="module")
def space(tmp_path_factory):
    scene = SPACE | {"particles": [SPACE["particles"][0] | {"position": "lattice", "count": 27}, SPACE["particles"][1]]}
    scene["particles"][1] = scene["particles"][1] | {"position": [[1.4, 1.4, 1.4]], "radius": 0.3}
    return ran(tmp_path_factory.mktemp("space") / "run", **scene)


def test_space_is_shown_and_played(opened, space):
    page = opened(space)
    first = drawn(page)
    assert coloured(first).mean() > 0.005 and len(np.unique(first.reshape(-1, 3), axis=0)) > 500
    assert page.locator("#number").inner_text() == "frame 0 · 28 particles"
    page.uncheck("#again")  # however late the second click comes, it does not end where it began
    page.click("#play")
    page.wait_for_selector("body:not([data-frame='0']):not([data-frame='1'])")
    page.click("#play")
    assert page.evaluate("state.frame") > 1 and np.abs(drawn(page) - first).max() > 0.3
    page.keyboard.press("End")
    assert page.locator("#clock").inner_text() == "t = 1.2"
    page.keyboard.press("ArrowLeft")
    assert page.locator("#number").inner_text().startswith("frame 11")
    page.locator("#frame").fill("5")
    assert page.locator("#clock").inner_text() == "t = 0.5"


def test_the_user_chooses_what_is_shown(opened, space):
    page = opened(space)
    offered = page.locator("#color option").all_inner_texts()
    assert set(offered) == {"id", "mass", "radius", "drag", "speed", "kinetic energy"}
    before = drawn(page)
    for change in (
        "state.color = 'mass'; recolor()",
        "state.map = 'plasma'; recolor()",
        "state.grow = 2; recolor()",
        "document.getElementById('walls').click()",
        "document.getElementById('box').click()",
        "document.getElementById('above').click()",
        "document.getElementById('dark').click()",
    ):
        page.evaluate(change)
        after = drawn(page)
        assert np.abs(after - before).max() > 0.2, change
        before = after
    box = page.locator("#canvas").bounding_box()
    page.mouse.move(box["x"] + 300, box["y"] + 300)
    page.mouse.down()
    page.mouse.move(box["x"] + 400, box["y"] + 340)
    page.mouse.up()
    assert np.abs(drawn(page) - before).max() > 0.2
    texts = page.locator("#effects").inner_text()
    assert "walls" in texts and "not run:" in page.locator("#not_run").inner_text()
    assert page.locator("#curves figure").count() >= 3


def test_a_sphere_has_its_true_size_place_and_colour(opened, tmp_path):
    """From above, one pixel is known: the coloured area is that of the discs, and a click on one tells who it is."""
    scene = {
        "dimension": 2,
        "box": {"lower": [0, 0], "upper": [10, 6]},
        "time": {"step": 0.1, "steps": 1},
        "particles": [{"position": [[3, 3]], "radius": 1.0, "velocity": [1.0, 0.0]}, {"position": [[7, 3]], "radius": 0.5}],
    }
    page = opened(ran(tmp_path / "run", **scene))
    picture = drawn(page)
    unit = page.evaluate("camera.pixel(canvas.clientHeight)")
    area = coloured(picture).sum() * unit**2
    assert area == pytest.approx(np.pi * (1.0 + 0.25), rel=0.05)
    high, wide = picture.shape[:2]

    def pixel(x, y):
        return int(high / 2 - (y - 3) / unit), int(wide / 2 + (x - 5) / unit)

    fastest, slowest = (np.array(colormaps["viridis"](share)[:3]) for share in (1.0, DARKEST))
    for x, radius, color in ((3, 1.0, fastest), (7, 0.5, slowest)):
        found = picture[pixel(x + 0.3 * radius, 3 - 0.3 * radius)]
        assert np.abs(found / found.max() - color / color.max()).max() < 0.12
        assert not coloured(picture)[pixel(x + 1.1 * radius, 3)] and coloured(picture)[pixel(x + 0.9 * radius, 3)]
    row, column = pixel(7, 3)
    page.locator("#canvas").click(position={"x": column, "y": row})
    assert page.locator("#picked").inner_text().startswith("particle 1 at (7, 3)")


def test_the_nearer_sphere_hides_the_one_behind_it(opened, tmp_path):
    scene = {
        "dimension": 3,
        "box": {"lower": [-3, -3, -3], "upper": [3, 3, 3]},
        "time": {"step": 0.1, "steps": 1},
        "particles": [{"position": [[0, 1, 0], [0, -1, 0]], "radius": 0.9, "velocity": [[1, 0, 0], [0, 0, 0]]}],
    }
    page = opened(ran(tmp_path / "run", **scene))
    seen = []
    for name in ("front", "turned"):
        page.evaluate("document.getElementById('front').click()" if name == "front" else "view(Math.PI / 2, 0)")
        picture = drawn(page)
        high, wide = picture.shape[:2]
        _, green, blue = picture[high // 2 + 10, wide // 2 + 10]
        seen.append("fast" if green > 1.5 * blue else "slow")
    assert seen == ["slow", "fast"]


def test_one_frame_and_points_without_radius(opened, tmp_path):
    scene = {"dimension": 3, "time": {"step": 0.1, "steps": 0}, "particles": [{"position": [[0, 0, 0], [1, 1, 1]]}]}
    page = opened(ran(tmp_path / "run", **scene))
    assert page.locator("#play").is_disabled() and coloured(drawn(page)).sum() > 20
    page.evaluate("spheres.gl.getExtension('WEBGL_lose_context').loseContext()")
    page.locator("#failed", has_text="load the page again").wait_for()


@pytest.mark.parametrize("dimension, count", [(1, 5), (2, 0), *(pytest.param(d, 40, marks=pytest.mark.slow) for d in (4, 5))])
def test_other_dimensions_and_nobody(opened, tmp_path, dimension, count):
    """A constant speed, a table of two rows: no range is empty, and what is constant has the middle of the colours."""
    particles = [{"count": count, "position": "random", "velocity": {"speed": 1.0}, "radius": 0.1}]
    scene = {
        "dimension": dimension,
        "box": {"lower": [0] * dimension, "upper": [3] * dimension},
        "time": {"step": 0.1, "steps": 5},
    }
    page = opened(ran(tmp_path / "run", **scene, particles=particles, effects={"walls": {}}))
    assert page.locator("#number").inner_text() == f"frame 0 · {count} particles" and page.locator("#curves figure").count() >= 2
    assert (coloured(drawn(page)).sum() > 100) == (count > 0)
    assert page.evaluate("range()") == pytest.approx([0.5, 1.5] if count else [0, 1])


CORNERS = """[-0.5, 0.5].map(k => project([k * sides[0], k * sides[1], 0])).flatMap(([x, y]) => [
  x / canvas.clientWidth, y / canvas.clientHeight])"""


@pytest.mark.parametrize("upper", [[6.0, 1.5], [1.5, 6.0]])
def test_all_of_a_plane_is_seen_in_a_window_of_any_size(opened, tmp_path, upper):
    """Until the user moves it or comes nearer. Sides that are periodic are dashed, floor and ceiling are not."""
    box, particles = {"lower": [0, 0], "upper": upper, "periodic": [True, False]}, [{"position": [[1.0, 1.0]], "radius": 0.1}]
    time, effects = {"step": 0.1, "steps": 2}, {"walls": {}}
    page = opened(ran(tmp_path / "run", dimension=2, box=box, time=time, particles=particles, effects=effects))
    for width, height in ((1200, 800), (700, 900), (1600, 500)):
        page.set_viewport_size({"width": width, "height": height})
        places = np.array(page.evaluate(f"new Promise(ready => requestAnimationFrame(() => ready({CORNERS})))"))
        assert places.min() > 0.0 and places.max() < 1.0
        assert np.abs(np.diff(places.reshape(2, 2), axis=0)).max() > 0.75  # nor is it small
    dashes, lines = 20, 4  # of an edge; edges along each axis, of which those along the third are points
    assert page.evaluate("boxLines().length") == lines * (dashes + 1 + 1)
    page.evaluate("camera.zoom(0.5)")
    page.set_viewport_size({"width": 1200, "height": 800})
    assert np.abs(np.diff(np.array(page.evaluate(CORNERS)).reshape(2, 2), axis=0)).max() > 1.0  # the user's choice stays


def test_particles_that_come_and_go_have_trails(opened, tmp_path):
    scene = {
        "dimension": 2,
        "time": {"step": 0.1, "steps": 6},
        "output": {"every": 1, "checkpoint_every": 1},
        "particles": [{"position": [[0, 0], [3, 0]], "velocity": [[0, 1], [0, -1]], "radius": 0.1}],
    }
    sim = Simulation(Scene(**scene))
    sim.run(tmp_path / "run", steps=3)
    sim.remove([0])
    sim.add({"position": [[1, 1]], "velocity": [1, 0], "radius": 0.2})
    sim.run(tmp_path / "run", resumed=True)
    page = opened(tmp_path / "run")
    page.keyboard.press("End")
    assert page.locator("#number").inner_text() == "frame 6 · 2 particles"
    with_trails = coloured(drawn(page)).sum()
    assert page.evaluate(LEAST_ALPHA) == 255  # what is half transparent is mixed with the ground, not with the page behind it
    page.locator("#trails").click()
    assert with_trails > coloured(drawn(page)).sum() + 100
    assert page.evaluate("trailLines().map(([path]) => path.length).sort().join()") == "3,4,7"


def test_a_run_that_is_going_on(opened, tmp_path):
    sim = Simulation(
        Scene(
            **SPACE
            | {
                "box": None,
                "effects": {},
                "particles": [{"position": [[0, 0, 0], [1, 1, 1]], "radius": 0.2, "velocity": [1, 0, 0]}],
            }
        )
    )
    step, notes = sim.step, []

    def look():
        step()
        if sim.steps_done == 5:
            page = opened(tmp_path / "run")
            notes.extend(page.locator("#notes li").all_inner_texts())
            page.keyboard.press("End")
            notes.append(page.locator("#clock").inner_text())

    sim.step = look
    sim.run(tmp_path / "run")
    assert "going on, at t = 0.4" in notes[0] and notes[-1] == "t = 0.4"
    page = opened(tmp_path / "run")
    assert not page.locator("#notes li").count()


def test_a_page_in_a_notebook_gets_new_frames_and_shows_the_last(browser, shown, tmp_path):
    """As a notebook does it: the page in a frame of its own, and scripts that send it what is new."""
    (first, _), messages = shown
    (tmp_path / "notebook.html").write_text(f"<body data-ready='yes'>{first._repr_html_()}</body>")
    page = browser(tmp_path / "notebook.html")
    inside = page.frame_locator("iframe")
    inside.locator("body[data-ready]").wait_for()
    assert inside.locator("#number").inner_text() == "frame 0 · 2 particles" and inside.locator("#play").is_disabled()
    for message in filter(None, messages):
        page.evaluate(message.removeprefix("<script>").removesuffix("</script>"))
    inside.locator("body[data-frame='4']").wait_for()
    assert inside.locator("#number").inner_text() == "frame 4 · 3 particles" and not inside.locator("#play").is_disabled()
    assert inside.locator("#curves figure").count() >= 2
    inside.locator("#frame").fill("1")
    assert inside.locator("#number").inner_text() == "frame 1 · 2 particles" and not browser.said
