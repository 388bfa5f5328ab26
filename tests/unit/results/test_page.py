"""The page of a run: what is in it are the numbers of the run, within the size that is allowed, and nothing from a network."""

import json
import re
from base64 import b64decode

import numpy as np
import pytest

from particles_mpi import Run, Scene, SceneError, Simulation
from particles_mpi.results.curves import MOST_ROWS, curves
from particles_mpi.results.page import Choice, PageColumn, choose, pack, page, survey, write_page
from particles_mpi.results.scenery import Scenery, section


@pytest.fixture(scope="module")
def gas(tmp_path_factory):
    """Frames of 50 spheres that move in 2D, one of them fixed; in the last ones there is one more."""
    folder = tmp_path_factory.mktemp("gas") / "run"
    scene = Scene(
        title="Gas & </script>",
        dimension=2,
        box={"lower": [100.0, 0.0], "upper": [110.0, 5.0]},
        time={"step": 0.1, "steps": 20},
        particles=[
            {"count": 49, "position": "lattice", "velocity": {"speed": 1.0}, "radius": 0.1, "mass": {"min": 1.0, "max": 2.0}},
            {"position": [[105.0, 4.9]], "radius": 0.01, "fixed": True},
        ],
        effects={"walls": {"restitution": 1.0}},
        output={"every": 1, "diagnostics_every": 1, "checkpoint_every": 1},
    )
    sim = Simulation(scene)
    sim.run(folder, steps=15)
    sim.add({"position": [[101.0, 4.9]], "radius": 0.01})
    sim.run(folder, resumed=True)
    return Run(folder)


def unpack(text):
    """(header, frames): of each frame the numbers that the page shows, by column."""
    header, blocks = (json.loads(re.search(rf'id="{name}"[^>]*>(.*?)</script>', text, re.S)[1]) for name in ("header", "frames"))

    def columns(block, wanted):
        data = b64decode(block)
        count, place, found = int(np.frombuffer(data, "<i8", 1)[0]), 8, {}
        for column in wanted:
            if column["type"]:
                width = 3 if column["name"] == "position" else 1
                raw = np.frombuffer(data, f"<{column['type']}", count * width, place)
                found[column["name"]] = np.array(column["offset"]) + np.array(column["scale"]) * raw.reshape(-1, width)
                place += -(-raw.nbytes // 8) * 8
        assert place == len(data)
        return found

    constant = columns(header["constant"], [c for c in header["columns"] if c["constant"]])
    moving = [c for c in header["columns"] if not c["constant"]]
    return header, [constant | columns(block, moving) for block in blocks]


def test_the_numbers_of_every_frame_are_in_the_page(gas):
    header, frames = unpack(page(gas))
    assert header["numbers"] == list(range(21)) and header["times"] == gas.times.tolist() and not header["notes"]
    for shown, frame in zip(frames, gas, strict=True):
        assert shown["id"][:, 0].tolist() == frame.id.tolist() and shown["fixed"][:, 0].tolist() == frame.fixed.tolist()
        assert np.abs(shown["position"][:, :2] - frame.position).max() < 1e-6 and not shown["position"][:, 2].any()
        for name in ("mass", "radius", "speed"):
            np.testing.assert_allclose(shown[name][:, 0], frame[name] if name != "speed" else frame.speed, rtol=1e-7)
    assert header["title"] == "Gas & </script>" and header["planar"] and header["trails"]
    assert header["box"] == {"lower": [100.0, 0.0, 0.0], "upper": [110.0, 5.0, 0.0], "real": True}
    assert [row[0] for row in header["effects"]] == ["walls"] and "collisions" in header["not_run"]


def test_what_does_not_change_is_stored_once(tmp_path):
    sim = Simulation(
        Scene(
            dimension=1,
            time={"step": 1.0, "steps": 3},
            particles=[{"position": [[0.0], [1.0]], "velocity": [1.0]}],
            output={"every": 1},
        )
    )
    sim.run(tmp_path / "run")
    columns, _, _ = survey(Run(tmp_path / "run"), Choice([0, 1, 2, 3], 1, "f4", []))
    assert {c.name for c in columns if not c.constant} == {"position"}


def test_a_page_is_as_large_as_it_may_be_and_says_what_it_leaves_out(gas):
    whole = page(gas)
    rest = len(whole) - sum(map(len, json.loads(re.search(r'id="frames"[^>]*>(.*?)</script>', whole, re.S)[1])))
    assert rest < 200_000  # script, curves, colours
    counts = [1000] * 600
    bare = choose(counts, 4, 4 * 7 * 600_000)
    assert bare == Choice(list(range(600)), 1, "f4", [])
    for room, frames, every in (
        (2 * 7 * 600_000, 600, 1),
        (2 * 7 * 100_000, 100, 1),
        (2 * 7 * 60_000, 60, 1),
        (2 * 7 * 20_000, 60, 3),
    ):
        choice = choose(counts, 4, room)
        assert (len(choice.frames), choice.every, choice.kind) == (frames, every, "u2")
        assert 2 * 7 * sum(counts[k] for k in choice.frames) / choice.every <= room
        assert len(choice.notes) == 1 + (frames < 600) + (every > 1)
    assert choose(counts, 4, 4 * 7 * 600_000 - 1)[2] == choose(counts, 4, 4 * 7 * 600_000, 1)[2] == "u2"
    for room in (2 * 7 * 600_000, 2 * 7 * 60_000, 2 * 7 * 5_000):  # 5 numbers of each that do not change
        choice = choose(counts, 4, room, 5)
        assert (2 * 7 * sum(counts[k] for k in choice.frames) + 4 * 5 * 1000) / choice.every <= room
    assert choose([10**7] * 3, 4, 2 * 7 * 10**6)[:3] == ([0, 1, 2], 30, "u2")


def test_rounded_numbers_are_right_to_half_a_step_of_their_range(gas):
    header, frames = unpack(page(gas, largest=2_000_000 + 30_000))
    assert len(frames) == 21 and "1/65535" in header["notes"][0]
    for shown, frame in zip(frames, gas, strict=True):
        assert np.abs(shown["position"][:, :2] - frame.position).max() <= 10.0 / 65535
        assert np.abs(shown["speed"][:, 0] - frame.speed).max() <= 0.5001 / 65535
    header, frames = unpack(page(gas, largest=2_000_000 + 4_000))
    some = next(c for c in header["notes"] if c.startswith("one particle in"))
    every = int(some.split()[3])
    assert all(
        shown["id"][:, 0].tolist() == frame.id[frame.id % every == 0].tolist() for shown, frame in zip(frames, gas, strict=True)
    )


def test_the_page_is_one_file_without_a_link_to_anything(gas, tmp_path):
    path = write_page(gas, tmp_path / "page.html")
    text = path.read_text()
    assert "default-src 'none'" in text and [p.name for p in tmp_path.iterdir()] == ["page.html"]
    without = re.sub(r"<script id=.*?</script>", "", text, flags=re.S)
    assert not re.search(r"https?:|//[a-z0-9.-]+\.[a-z]{2,}/|\bsrc\s*=|@import|\bfetch\(|XMLHttpRequest|import\(", without)
    assert text.count("</script>") == 3  # the title of the run does not end one


def test_a_run_without_frames_and_a_folder_that_cannot_be_written(tmp_path):
    sim = Simulation(Scene(dimension=2, time={"step": 1.0, "steps": 1}, particles=[{"position": [[0, 0]]}]))
    sim.run(tmp_path / "run")
    with pytest.raises(SceneError, match="cannot be written"):
        write_page(Run(tmp_path / "run"), tmp_path / "nowhere" / "page.html")
    (tmp_path / "run" / "trajectory.vtkhdf").unlink()
    with pytest.raises(SceneError, match=r"trajectory\.vtkhdf"):
        write_page(Run(tmp_path / "run"))


def test_curves_keep_sums_however_long_the_table():
    for rows in (3, 4, MOST_ROWS - 1, MOST_ROWS, MOST_ROWS + 1, 5 * MOST_ROWS + 3):
        time = np.linspace(0.0, 7.0, rows)
        counts = np.arange(rows) % 5
        counts[0] = 0
        table = {
            "time": time,
            "kinetic": time**2,
            "potential": np.full(rows, np.nan),
            "total_energy": np.full(rows, np.nan),
            "max_speed": time,
            "collisions": counts,
            "wall_hits": 0 * counts,
            "missed": 0 * counts,
        }
        panels = {panel["title"]: panel for panel in curves(table)}
        assert panels["energy"]["lines"].keys() == {"kinetic"} and "momentum" not in panels
        events = panels["events per unit time"]
        assert events["lines"].keys() == {"collisions"} and len(events["time"]) <= MOST_ROWS
        last = int(np.searchsorted(time, events["time"][-1] - 1e-6))
        lasting = np.diff([0.0, *events["time"]])
        assert np.dot(events["lines"]["collisions"], lasting) == pytest.approx(counts[: last + 1].sum(), rel=1e-4)
    assert curves({"time": np.zeros(1)}) == []


def test_the_section_of_a_cube_through_its_middle_is_a_regular_hexagon():
    cut = section(np.full(3, 0.5), np.array([1.0, 1.0, 1.0]), np.zeros(3), np.ones(3))
    sides = np.linalg.norm(np.diff(np.vstack([cut, cut[:1]]), axis=0), axis=1)
    assert len(cut) == 6 and sides == pytest.approx(np.full(6, np.sqrt(0.5)))
    for normal in np.vstack([np.eye(3), -np.eye(3)]):  # the faces themselves are no walls of their own
        assert not len(section(np.where(normal > 0, 0.0, 1.0), normal, np.zeros(3), np.ones(3)))


def test_around_a_single_point_there_is_room():
    around = Scenery({}, np.array([5.0, 1.0, 0.0]), np.array([5.0, 1.0, 0.0]))
    assert around.lower.tolist() == [4.0, 0.0, -1.0] and around.upper.tolist() == [6.0, 2.0, 1.0]


def test_a_plane_in_two_dimensions_is_a_line():
    scene = {"box": {"lower": [0, 0], "upper": [2, 1]}, "effects": {"walls": {"planes": [{"point": [1, 0.5], "normal": [0, 2]}]}}}
    ((corners, _),) = Scenery(scene, np.zeros(3), np.ones(3)).walls
    assert sorted(corners.tolist()) == [[0, 0.5, 0], [2, 0.5, 0]]


def test_walls_end_where_they_meet():
    """Two planes at 45 degrees that meet above the floor, and the floor, which is behind them everywhere."""
    planes = [
        {"point": [0.5, 0, 0.2], "normal": [1, 0, 1]},
        {"point": [0.5, 0, 0.2], "normal": [-1, 0, 1]},
        {"point": [0, 0, 0.1], "normal": [0, 0, 1]},
    ]
    around = Scenery(
        {"box": {"lower": [0, 0, 0], "upper": [1, 1, 1]}, "effects": {"walls": {"planes": planes}}}, np.zeros(3), np.ones(3)
    )
    assert len(around.walls) == 2
    for (corners, _), side in zip(around.walls, (0.0, 1.0), strict=True):
        expected = [[side, 0, 0.7], [side, 1, 0.7], [0.5, 0, 0.2], [0.5, 1, 0.2]]
        assert sorted(corners.tolist()) == pytest.approx(np.array(sorted(expected)))


def test_an_axis_of_the_box_is_periodic_where_the_scene_says_so():
    for d in (1, 2, 3, 4):
        flags = [k % 2 == 0 for k in range(d)]
        for given, right in ((True, [True] * d), (False, [False] * d), (flags, flags)):
            box = {"lower": [0] * d, "upper": [4] * d, "periodic": given}
            assert Scenery({"box": box}, np.zeros(3), np.ones(3)).periodic.tolist() == [*right, False, False][:3]


def test_walls_that_are_switched_off_are_not_drawn():
    planes = [{"point": [2, 2, 2], "normal": [0, 0, 1]}]
    for active in (False, True):
        box, walls = {"lower": [0, 0, 0], "upper": [4, 4, 4]}, {"active": active, "planes": planes}
        assert len(Scenery({"box": box, "effects": {"walls": walls}}, np.zeros(3), np.ones(3)).walls) == active


def test_what_is_no_number_is_not_shown_as_zero():
    """A column of an effect may be; the rest of the frame is shown as it is."""

    class Frame:
        id, position, velocity, mass, radius = np.arange(2), np.zeros((2, 3)), np.zeros((2, 3)), np.ones(2), np.ones(2)
        fields, speed, hot = ("hot",), np.zeros(2), np.array([np.nan, 5.0])

        def __getitem__(self, name):
            return getattr(self, name)

    block = b64decode(pack(Frame(), [PageColumn("hot", "f4", False)], 1))
    assert np.array_equal(np.frombuffer(block[8:16], "<f4"), [np.nan, 5.0], equal_nan=True)


def ones(time, *more):
    """A table of diagnostics in which everything is 1."""
    names = ["kinetic", "potential", "total_energy", "momentum_x", "max_speed", "collisions", "wall_hits", "missed"]
    return {"time": np.array(time)} | {name: np.ones(len(time)) for name in (*names, *more)}


def test_no_rate_is_told_of_an_interval_in_which_the_clock_was_set_back():
    (events,) = (panel for panel in curves(ones([0.0, 1.0, 2.0, 0.5, 1.5])) if panel["title"].startswith("events"))
    assert events["lines"]["collisions"] == [1.0, 1.0, 0.0, 1.0]


def test_the_energy_of_spins_is_a_curve_of_its_own():
    assert "rotational" in curves(ones([0.0, 1.0], "rotational"))[0]["lines"]
