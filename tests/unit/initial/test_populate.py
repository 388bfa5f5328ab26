"""Initial particles: places, velocities, and the faults of a start."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from particles_mpi import Simulation
from particles_mpi.errors import SceneError
from particles_mpi.initial.populate import populate
from particles_mpi.initial.table_file import read_table
from particles_mpi.scene.schema import Scene


def scene(particles, d=2, upper=1.0, periodic=False, effects=None, step=1e-3, folder=None, **more):
    given_tables = {
        "dimension": d,
        "seed": 5,
        "box": {"lower": [0.0] * d, "upper": [upper] * d, "periodic": periodic},
        "time": {"step": step, "steps": 1},
        "particles": particles if isinstance(particles, list) else [particles],
        "effects": {"collisions": {}} if effects is None else effects,
        **more,
    }
    return Scene.from_dict(given_tables, folder) if folder else Scene.from_dict(given_tables)


def start(*args, **kwargs):
    return populate(scene(*args, **kwargs))


def faults(*args, **kwargs):
    with pytest.raises(SceneError) as caught:
        start(*args, **kwargs)
    return "\n".join(caught.value.faults)


def deepest(particles, length=0.0):
    """Deepest relative overlap of any two, without the program's own search; far below 0 if none come near one another."""
    x, radius = particles.position, particles.radius
    tree = KDTree(x % length if length else x, boxsize=length or None)
    i, j = tree.query_pairs(2.0 * radius.max() * (1.0 + 1e-9), output_type="ndarray").T
    r = x[i] - x[j]
    if length:
        r -= length * np.rint(r / length)
    return (1.0 - np.sqrt((r**2).sum(axis=1)) / (radius[i] + radius[j])).max(initial=-np.inf)


# places


@settings(max_examples=60)
@given(st.integers(1, 5), st.booleans(), st.integers(0, 60), st.booleans(), st.sampled_from(["random", "lattice"]))
def test_places_never_overlap_and_stay_inside(d, periodic, count, polydisperse, position):
    radius = 0.18 * 0.2 ** (1 / d) * max(count, 8) ** (-1.0 / d)
    big = {"min": 0.2 * radius, "max": 2.0 * radius} if polydisperse else radius
    populations = [
        {"count": count, "position": position, "radius": big},
        {"position": [[0.5] * d], "radius": radius, "fixed": True}
        if position == "random"
        else {"count": 0, "position": "random"},
    ]
    particles, warnings = start(populations, d=d, periodic=periodic, effects={"collisions": {}, "walls": {}})
    assert not warnings
    assert np.array_equal(particles.id, np.arange(len(particles)))
    if len(particles) > 1:
        assert deepest(particles, 1.0 if periodic else 0.0) < 1e-12
    margin = 0.0 if periodic else particles.radius[:, None] * (1 - 1e-9)
    assert ((particles.position >= margin) & (particles.position <= 1 - margin)).all()


def test_random_spheres_of_very_different_size_keep_clear():
    populations = [
        {"count": 300, "position": "random", "radius": {"min": 0.001, "max": 0.01}},
        {"count": 3, "position": "random", "radius": 0.15},
        {"position": [[0.1, 0.1], [0.95, 0.5]], "radius": 0.04},
    ]
    particles, _ = start(populations, periodic=True)
    assert deepest(particles, 1.0) < 1e-12


def test_random_points_are_uniform_and_may_coincide_only_without_collisions():
    particles, _ = start({"count": 20000, "position": "random", "radius": 0.2}, effects={})
    assert np.abs(particles.position.mean(axis=0) - 0.5).max() < 4 * np.sqrt(1 / 12 / 20000)
    assert particles.position.min() < 0.01 and particles.position.max() > 0.99


def test_random_stays_inside_oblique_walls():
    walls = {"planes": [{"point": [0.5, 0.5], "normal": [-1, -1]}]}
    particles, _ = start({"count": 50, "position": "random", "radius": 0.02}, effects={"collisions": {}, "walls": walls})
    assert ((1.0 - particles.position.sum(axis=1)) / np.sqrt(2) >= 0.02 * (1 - 1e-9)).all()


@pytest.mark.parametrize(("d", "packing"), [(2, 0.85), (3, 0.70)])
@pytest.mark.parametrize("periodic", [True, False])
def test_lattice_reaches_high_packing(d, packing, periodic):
    count = {2: 900, 3: 4000}[d]
    packing = packing if periodic else packing - 0.1
    volume = {2: np.pi, 3: 4 * np.pi / 3}[d]
    radius = (packing / count / volume) ** (1 / d)
    particles, _ = start({"count": count, "position": "lattice", "radius": radius}, d=d, periodic=periodic)
    assert len(particles) == count
    assert deepest(particles, 1.0 if periodic else 0.0) < 1e-12


@pytest.mark.parametrize("position", ["random", "lattice"])
@pytest.mark.parametrize(("d", "radius"), [(1, 0.01), (2, 0.06), (3, 0.13), (3, 0.7), (5, 0.3)])
def test_what_cannot_fit_is_told_quickly(position, d, radius):
    begin = time.process_time()
    told = faults({"count": 100, "position": position, "radius": radius}, d=d)
    assert "particles[0].position" in told
    assert time.process_time() - begin < 2.0


def test_the_same_seed_gives_the_same_bits_and_streams_are_independent():
    populations = [
        {
            "count": 50,
            "position": "random",
            "radius": 0.01,
            "velocity": {"speed": {"min": 1, "max": 2}},
            "mass": {"min": 1, "max": 2},
        },
        {"count": 50, "position": "random", "radius": 0.01, "velocity": {"temperature": 2.0}},
    ]
    a, b = start(populations)[0], start(populations)[0]
    assert all(np.array_equal(a[name], b[name]) for name in a.arrays)
    other = [{**populations[0], "mass": 1.0, "velocity": [0, 1]}, populations[1]]
    c = start(other)[0]
    assert np.array_equal(a.position, c.position) and np.array_equal(a.velocity[50:], c.velocity[50:])
    assert not np.array_equal(a.velocity[:50], a.velocity[50:])


def test_a_header_tells_which_columns_are_meant(tmp_path):
    """One file for places and velocities, in any order; what is named by halves is refused."""
    (tmp_path / "a.csv").write_text('mass,Y, x,"vy",vx\n7,0.2,0.1,-2,1\n8,0.6,0.5,4,3\n')
    sim, _ = start({"position": {"file": "a.csv"}, "velocity": {"file": "a.csv"}, "radius": 0.01}, folder=tmp_path)
    assert sim.position.tolist() == [[0.1, 0.2], [0.5, 0.6]] and sim.velocity.tolist() == [[1.0, -2.0], [3.0, 4.0]]
    (tmp_path / "b.csv").write_text("x,vx,z\n1,2,3\n")
    for name, says in (("position", "x, but no y"), ("velocity", "vx, but no vy")):
        told = faults({"position": [[0.0, 0.0]], name: {"file": "b.csv"}}, folder=tmp_path)
        assert told == f"particles[0].{name}: {tmp_path / 'b.csv'}: its header has {says}"
    (tmp_path / "c.csv").write_text("x,y,mass\n0.1,0.2,3\n")
    told = faults({"position": {"file": "c.csv"}, "velocity": {"file": "c.csv"}}, folder=tmp_path)
    assert told == f"particles[0].velocity: {tmp_path / 'c.csv'}: its header has x, y, mass, but no vx"
    for row, says in (("0.1", "line 3: too few columns: 1"), ("0.1,a", "in column 2 to a number")):
        (tmp_path / "e.csv").write_text(f"x,y\n0.5,0.5\n{row}\n")
        assert says in faults({"position": {"file": "e.csv"}}, folder=tmp_path)
    (tmp_path / "d.csv").write_text("id,px,py\n0,0.1,0.2\n")
    told = faults({"position": {"file": "d.csv"}}, folder=tmp_path)
    assert told == f"particles[0].position: {tmp_path / 'd.csv'}: its header has id, px, py, but no x"


def test_a_file_of_places_gives_velocities_too_where_its_header_names_them(tmp_path):
    (tmp_path / "a.csv").write_text("x,y,vx,vy\n0.1,0.2,1,-2\n0.5,0.6,3,4\n")
    for more, expected in (({}, [[1.0, -2.0], [3.0, 4.0]]), ({"velocity": [5.0, 0.0]}, [[5.0, 0.0]] * 2)):
        particles, _ = start({"position": {"file": "a.csv"}, "radius": 0.01} | more, folder=tmp_path)
        assert particles.velocity.tolist() == expected
    (tmp_path / "b.csv").write_text("x,y,vx\n0.1,0.2,1\n")
    assert "its header has vx, but no vy" in faults({"position": {"file": "b.csv"}}, folder=tmp_path)


@pytest.mark.parametrize(("d", "axes"), [(2, ["spin"]), (3, ["spin_x", "spin_y", "spin_z"])])
def test_a_file_gives_all_that_a_population_can_have(tmp_path, d, axes):
    """As a list in the scene does: what is fixed, spins, accelerations, whatever the order of the columns."""
    names = ["fixed", *[f"acceleration_{axis}" for axis in "xyz"[:d]], *"xyz"[:d], *axes, "radius", "moment_of_inertia"]
    rows = np.round(np.random.default_rng(5).uniform(0.2, 0.8, (4, len(names))), 3)
    rows[:, 0], rows[0, -2 - len(axes) : -2] = [1, 0, 0, 1], 0.0
    rows[3, -2 - len(axes) : -2], rows[:, -2] = 0.0, 0.01
    (tmp_path / "a.csv").write_text("\n".join([",".join(names), *(",".join(map(str, row)) for row in rows.tolist())]))
    effects = {"collisions": {"friction": 0.3}, "user_acceleration": {}}
    particles, warnings = start({"position": {"file": "a.csv"}}, d=d, folder=tmp_path, effects=effects)
    of = {name: rows[:, k] for k, name in enumerate(names)}
    listed = {name: np.column_stack([of[f"{name}_{axis}"] for axis in "xyz"[:d]]).tolist() for name in ("acceleration",)}
    listed |= {"position": np.column_stack([of[axis] for axis in "xyz"[:d]]).tolist(), "fixed": [True, False, False, True]}
    listed |= {"spin": (np.column_stack([of[axis] for axis in axes]) if d == 3 else of["spin"]).tolist()}
    same, _ = start(listed | {n: of[n].tolist() for n in ("radius", "moment_of_inertia")}, d=d, effects=effects)
    assert not warnings and all(np.array_equal(particles[name], same[name]) for name in same.arrays)
    assert particles.fixed.tolist() == [1, 0, 0, 1] and particles.spin[1].tolist() == rows[1, -2 - len(axes) : -2].tolist()


def test_what_is_fixed_by_a_file_is_0_or_1(tmp_path):
    for value, says in (("2", "neither 0 nor 1 for particle 1"), ("0.5", "not a whole number of type uint8 for particle 1")):
        (tmp_path / "a.csv").write_text(f"x,y,fixed\n0.1,0.2,1\n0.5,0.6,{value}\n")
        told = faults({"position": {"file": "a.csv"}, "radius": 0.01}, folder=tmp_path)
        assert told == f"particles[0].fixed: {says}"


def test_columns_that_the_scene_overrides_are_told(tmp_path):
    (tmp_path / "a.csv").write_text("x,y,radius\n0.1,0.2,0.05\n0.5,0.6,0.05\n")
    particles, warnings = start({"position": {"file": "a.csv"}, "radius": 0.01}, folder=tmp_path)
    assert particles.radius.tolist() == [0.01, 0.01]
    assert warnings == ["particles[0].radius: the value in the scene is used, not that in a.csv"]


@pytest.mark.parametrize("header", ["", "x,y\n"])
def test_a_line_has_as_many_columns_as_the_first(tmp_path, header):
    """As it has more where a comma is meant to be a point."""
    (tmp_path / "a.csv").write_text(f"{header}1,2\n\n1,5,2,5\n")
    told = faults({"position": {"file": "a.csv"}}, folder=tmp_path)
    assert told.endswith(f"a.csv: line {3 + bool(header)} has 4 columns, but line 1 has 2")


@pytest.mark.filterwarnings("ignore")  # `catch_warnings` is one for all threads
def test_a_header_counts_wherever_it_is_read(tmp_path):
    """Of a file with fewer bytes than there are ranks the first ones have no line, rank 0 neither."""
    (tmp_path / "a.csv").write_text("vx,x\n1,2\n")
    size, told, barrier = 12, {}, threading.Barrier(12)

    class Rank:
        def __init__(self, rank):
            self.rank, self.size, self.calls = rank, size, 0

        def allgather(self, value):
            self.calls += 1
            told.setdefault(self.calls, {})[self.rank] = value
            barrier.wait()
            return [told[self.calls][rank] for rank in range(size)]

    with ThreadPoolExecutor(size) as pool:
        read = list(pool.map(lambda rank: read_table(Rank(rank), tmp_path / "a.csv", "position", 1), range(size)))
    assert [table.total for table in read] == [1] * size
    assert np.concatenate([table.values for table in read]).tolist() == [[2.0]]


def test_columns_beyond_three_axes_are_taken_in_order(tmp_path):
    """A header that says otherwise is refused."""
    for header, says in (
        ("x,y,z,w", ""),
        ("a,b,c,d", ""),
        ("y,x,z,w", "its header has y, x, z; in dimension 4"),
        *((f"x,y,z,{name}", f"its header has {name}; in dimension 4") for name in ("mass", "fixed", "spin_x", "vx")),
    ):
        (tmp_path / "a.csv").write_text(f"{header}\n1,2,3,4\n")
        if says:
            assert says in faults({"position": {"file": "a.csv"}}, dimension=4, box=None, folder=tmp_path)
        else:
            particles, _ = start({"position": {"file": "a.csv"}}, dimension=4, box=None, folder=tmp_path)
            assert particles.position.tolist() == [[1.0, 2.0, 3.0, 4.0]]
    (tmp_path / "a.csv").write_text("x,y,z,w,mass\n1,2,3,4,5\n")
    _, (warning,) = start({"position": {"file": "a.csv"}}, dimension=4, box=None, folder=tmp_path)
    assert "columns after the first 4 of" in warning and warning.endswith("are not read")


@pytest.mark.parametrize("dimension", [1, 2, 3, 4])
def test_lists_without_an_entry_are_no_particles(dimension):
    """At the start and later, with values of any form; but not where other lists have entries, or `count` asks for some."""
    more = [{}, {"count": 0}, {"velocity": [], "mass": [], "radius": []}, {"velocity": [1.0] * dimension, "mass": 2.0}]
    one = {"position": [[0.5] * dimension], "radius": 0.01}
    for values in more:
        assert len(start({"position": [], **values}, dimension=dimension, box=None)[0]) == 0
        sim = Simulation(scene(one, dimension=dimension, box=None))
        assert len(sim.add({"position": np.zeros((0, dimension)), **values})) == 0 and sim.total == 1
    assert "position: 0 entries, but count = 2" in faults({"count": 2, "position": []}, dimension=dimension, box=None)
    rough = {"effects": {"walls": {"friction": 0.3}}, "dimension": 3, "box": {"lower": [0.0] * 3, "upper": [1.0] * 3}}
    assert len(start({"position": [], "spin": []}, **rough)[0]) == 0
    for name in ("velocity", "mass"):
        assert f"{name}: 0 entries, but position has 1" in faults(one | {name: []}, dimension=dimension, box=None)


@pytest.mark.parametrize("header", ["", "y,x\n"])
def test_a_byte_order_mark_is_no_text(tmp_path, header):
    """Some programs begin a file with it."""
    (tmp_path / "a.csv").write_bytes(b"\xef\xbb\xbf" + f"{header}0.1,0.2\n0.5,0.6\n".encode())
    particles, _ = start({"position": {"file": "a.csv"}, "radius": 0.01}, folder=tmp_path)
    assert particles.position[:, :: -1 if header else 1].tolist() == [[0.1, 0.2], [0.5, 0.6]]


def test_a_file_of_places_gives_radii_and_masses_too_and_tells_what_is_not_read(tmp_path):
    """Behind comments and empty lines; the scene's own values come first."""
    (tmp_path / "a.csv").write_text("# from a lab\n\nx,y,radius,mass,colour\n0.1,0.2,0.03,2,7\n0.5,0.6,0.04,3,8\n")
    own = {"position": {"file": "a.csv"}}
    for more, radius, mass in (({}, [0.03, 0.04], [2.0, 3.0]), ({"mass": 5.0, "radius": 0.01}, [0.01] * 2, [5.0] * 2)):
        particles, warnings = start(own | more, folder=tmp_path)
        assert particles.radius.tolist() == radius and particles.mass.tolist() == mass
        assert len(warnings) == 1 + len(more) and "columns colour of" in warnings[0]
    (tmp_path / "b.csv").write_text("0.1,0.2,1,2\n")
    _, warnings = start({"position": {"file": "b.csv"}}, folder=tmp_path)
    assert len(warnings) == 1 and "add a header that names them" in warnings[0]
    (tmp_path / "a.csv").write_text("# from a lab\n\nx,y,radius\n0.1,0.2,0.03\n0.5,0.6,a\n")
    assert "line 5: " in faults(own, folder=tmp_path)


@pytest.mark.parametrize("line", [",0.1", "1.0D0,0.1", "--,0.1", "0x1,0.1", "nan,nan", "--,--", "0.1 0.2"])
def test_a_line_of_broken_numbers_is_no_header(tmp_path, line):
    (tmp_path / "a.csv").write_text(f"{line}\n0.2,0.2\n0.3,0.3\n")
    told = faults({"position": {"file": "a.csv"}}, folder=tmp_path)
    assert "a.csv: line " in told


def test_a_column_that_is_named_twice_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("x,x,y\n0.1,0.2,0.3\n")
    assert "its header has x twice" in faults({"position": {"file": "a.csv"}}, folder=tmp_path)


def test_csv_with_and_without_header(tmp_path):
    (tmp_path / "a.csv").write_text("x,y,note\n0.1,0.2,7\n0.5,0.6,8\n")
    (tmp_path / "b.csv").write_text("1.0,2.0\n3.0,4.0\n")
    population = {"position": {"file": "a.csv"}, "velocity": {"file": "b.csv"}, "radius": [0.01, 0.02]}
    particles, _ = start(population, folder=tmp_path)
    assert particles.position.tolist() == [[0.1, 0.2], [0.5, 0.6]]
    assert particles.velocity.tolist() == [[1.0, 2.0], [3.0, 4.0]]
    (tmp_path / "a.csv").write_text('"x","y","note"\n"0.1","0.2",7\n0.5,"0.6","8"\n')
    assert start(population, folder=tmp_path)[0].position.tolist() == [[0.1, 0.2], [0.5, 0.6]]


@pytest.mark.parametrize("text", ["x;y\n0.1;0.2\n", "0.1;0.2\n0.3;0.4\n"])
def test_semicolons_separate_nothing_and_that_is_told(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    assert faults({"position": {"file": "a.csv"}}, folder=tmp_path).endswith("columns are separated by commas)")


@pytest.mark.parametrize("text", [None, "", "x,y\n", "0.1\n", "0.1,0.2\n0.3,oops\n", "0.1,nan\n", "0.1,0.2\n0.3\n", "\udcff,1\n"])
def test_bad_csv_is_a_fault(tmp_path, text):
    if text is not None:
        (tmp_path / "a.csv").write_bytes(text.encode("utf-8", "surrogateescape"))
    told = faults({"position": {"file": "a.csv"}}, folder=tmp_path)
    assert told.startswith("particles[0].position: ") and "a.csv" in told


# velocities, masses, fields


def test_speed_is_exact_and_isotropic():
    particles, _ = start({"count": 4000, "position": "random", "velocity": {"speed": 0.5}}, d=3, effects={})
    speed = np.sqrt((particles.velocity**2).sum(axis=1))
    assert np.allclose(speed, 0.5, rtol=1e-14)
    second = (particles.velocity**2).mean(axis=0) / 0.25
    assert np.allclose(second, 1 / 3, atol=4 * np.sqrt(4 / 45 / 4000))


def test_temperature_is_exact_and_the_whole_at_rest():
    population = {"count": 300, "position": "random", "velocity": {"temperature": 2.5}, "mass": {"min": 0.1, "max": 3}}
    population["fixed"] = [k % 10 == 0 for k in range(300)]
    particles, _ = start(population, d=3, effects={})
    free = particles.fixed == 0
    m, v = particles.mass[free], particles.velocity[free]
    assert np.isclose((m[:, None] * v**2).sum(), 3 * free.sum() * 2.5, rtol=1e-13)
    assert np.abs((m[:, None] * v).sum(axis=0)).max() < 1e-11
    assert not particles.velocity[~free].any()


@pytest.mark.parametrize("masses", [[1.0], [0.5, 0.5], [0.25] * 4, [1.0, 0.0]])
def test_a_plummer_sphere_of_several_populations_is_in_equilibrium(masses):
    """Each of them moves in the field of all, test particles too: the mean square of velocities is 3 pi/32."""
    sphere = {"count": 2000, "position": {"plummer": 1.0}, "velocity": "equilibrium"}
    parts = [sphere | {"mass": m / 2000} for m in masses]
    time, effects = {"step": 0.01, "steps": 1}, {"mutual_gravity": {"G": 1.0, "method": "tree"}}
    sim = Simulation(Scene(dimension=3, time=time, effects=effects, particles=parts))
    assert sim.measure()["virial_ratio"] == pytest.approx(1.0, abs=0.05)
    squares = (sim.particles.velocity**2).sum(axis=1).reshape(len(masses), -1).mean(axis=1)
    assert squares == pytest.approx(3 * np.pi / 32, rel=0.1)


def test_fields_are_those_the_effects_name():
    plain, _ = start({"position": [[0.5, 0.5]]}, effects={})
    assert list(plain.arrays) == ["id", "position", "velocity", "radius", "mass", "fixed"]
    assert plain.mass[0] == 1.0
    effects = {"drag": {"rate": 0.3}, "user_acceleration": {}}
    more, _ = start(
        [{"position": [[0.5, 0.5]], "acceleration": [1, 2]}, {"position": [[0.2, 0.5]], "drag": 0.7}], effects=effects
    )
    assert more.drag.tolist() == [0.3, 0.7]
    assert more.acceleration.tolist() == [[1, 2], [0, 0]]
    taylor, _ = start({"position": [[0.5, 0.5]]}, effects={}, time={"step": 0.1, "steps": 1, "integrator": "taylor"})
    assert taylor.rate.shape == (1, 2) and not taylor.rate.any()


@pytest.mark.parametrize(
    ("population", "words"),
    [
        ({"position": [[0.5, 0.5]], "mass": -1.0}, "particles[0].mass: negative for particle 0"),
        ({"position": [[0.5, 0.5]], "mass": 0.0}, "particles[0].mass: [effects.collisions] divides by it, so it must be above 0"),
        ({"position": [[0.5, 0.5]], "radius": -1.0}, "particles[0].radius: negative"),
        ({"position": [[0.5, 0.5]], "radius": [0.1, 0.1]}, "particles[0].radius: 2 entries, but position has 1"),
        ({"position": [[0.5, 0.5]], "count": 2}, "particles[0].position: 1 entries, but count = 2"),
        ({"position": [[0.5, 0.5]], "fixed": True, "velocity": [0, 1]}, "particles[0].velocity"),
        ({"position": [[0.5, 0.5]], "fixed": True, "velocity": {"speed": 1}}, "particles[0].velocity"),
        ({"count": 10**15, "position": "random"}, "particles[0].count"),
        ({"position": [[0.5, 1.5]]}, "box: particle 0 outside"),
        ({"position": [[0.5, 0.04]], "radius": 0.05}, "effects.walls.planes[2]: particle 0 not fully on the free side"),
    ],
)
def test_faults_name_key_and_particle(population, words):
    assert words in faults(population, effects={"collisions": {}, "walls": {}})


def test_mass_zero_where_nothing_divides_by_it():
    assert start({"position": [[0.5, 0.5]], "mass": 0.0}, effects={})[0].mass[0] == 0.0
    assert start({"position": [[0.5, 0.5]], "mass": 0.0, "fixed": True})[0].mass[0] == 0.0
    assert "effects.friction" in faults(
        {"position": [[0.5, 0.5]], "mass": 0.0, "fixed": True}, effects={"friction": {"strength": 1.0}}
    )


@pytest.mark.parametrize("walls", [{"friction": 0.3}, {"tangential_restitution": 0.5}])
def test_rough_walls_divide_by_masses(walls):
    """For what they turn has a moment of inertia; smooth ones do not, until they are made rough."""
    ball = {"position": [[0.5, 0.5]], "radius": 0.1, "mass": 0.0}
    assert "particles[0].mass: [effects.walls] divides by it, so it must be above 0" in faults(ball, effects={"walls": walls})
    tables = {"box": {"lower": [0.0, 0.0], "upper": [1.0, 1.0]}, "time": {"step": 0.01, "steps": 1}, "particles": [ball]}
    sim = Simulation(Scene(dimension=2, effects={"walls": {}}, **tables))
    for key, value in walls.items():
        with pytest.raises(SceneError, match=f"effects.walls.{key}: .* particle 0 has none"):
            setattr(sim.effects["walls"], key, value)
    sim.step()


# the start


def test_long_lists_of_ids_are_cut_short():
    told = faults({"count": 20, "position": "lattice", "radius": 0.01, "velocity": [50, 0]})
    assert "time.step: particles 0, 1, 2, 3, 4 and 15 more cross more than their diameter" in told
    assert "use a step <= 0.0004" in told


def test_the_advised_step_is_accepted():
    population = {"position": [[0.5, 0.5]], "radius": 0.0123, "velocity": [33.3, 1.7]}
    advised = float(faults(population, step=0.1).rsplit(" ", 1)[1])
    start(population, step=advised)


def test_points_are_warned_of():
    _, warnings = start({"position": [[0.5, 0.5]], "velocity": [1000, 0]})
    assert "radius 0" in warnings[0]


@pytest.mark.parametrize(
    ("effect", "by"),
    [("drag", {"drag": 0.1}), ("user_acceleration", {"acceleration": [0.0, 0.1]}), ("mutual_gravity", {"mass": 1.0})],
)
def test_an_effect_that_acts_on_nobody_is_told(effect, by):
    population = {"position": [[0.5, 0.5]], "radius": 0.01, "mass": 0.0}
    (told,) = start(population, effects={effect: {}})[1]
    assert told.startswith(f"effects.{effect}: ")
    assert not start([population, population | {"position": [[0.2, 0.2]]} | by], effects={effect: {}})[1]
    if effect == "drag":
        assert not start(population, effects={"drag": {"rate": 0.1}})[1]


@pytest.mark.parametrize(
    ("effect", "key", "none", "some"),
    [
        ("uniform_gravity", "acceleration", [0.0, 0.0], [0.0, -1.0]),
        ("friction", "strength", 0.0, 1.0),
        ("mutual_gravity", "G", 0.0, 1.0),
    ],
)
def test_an_effect_of_no_strength_is_told(effect, key, none, some):
    population = {"position": [[0.5, 0.5]], "mass": 1.0}
    (told,) = start(population, effects={effect: {key: none}})[1]
    assert told.startswith(f"effects.{effect}.{key}: 0")
    assert not start(population, effects={effect: {key: some}})[1]


def test_a_step_in_which_forces_move_spheres_far_is_warned_of():
    """By more than a radius: of those that can move and are no points, by the common and by their own acceleration."""
    population = {"position": [[0.2, 0.5], [0.5, 0.5], [0.8, 0.5]], "radius": [0.01, 0.0, 0.1], "fixed": [False, False, True]}
    gravity = {"collisions": {}, "uniform_gravity": {"acceleration": [0.0, -9.0]}}
    own = {"collisions": {}, "user_acceleration": {}}
    for effects, more in ((gravity, {}), (own, {"acceleration": [[0.0, 9.0]] * 2 + [[0.0, 0.0]]})):
        _, warnings = start(population | more, effects=effects, step=0.1)
        assert warnings[0].startswith("time.step: forces move particle 0 by more than a radius in a step of 0.1")
        assert warnings[0].endswith("a step <= 0.0333")
        assert start(population | more, effects=effects, step=0.0333)[1] == []


def test_overlap_names_the_pairs_and_touching_is_none():
    touching = {"position": [[0.2, 0.5], [0.4, 0.5], [0.4, 0.7]], "radius": 0.1}
    assert start(touching)[1] == []
    told = faults({"position": [[0.2, 0.5], [0.9, 0.9], [0.39, 0.5]], "radius": 0.1})
    assert told.startswith("effects.collisions: pair 0-2 overlaps")
    across = {"position": [[0.05, 0.5], [0.95, 0.5]], "radius": 0.06}
    assert "pair 0-1" in faults(across, periodic=True)
    assert start(across)[1] == []
    assert start({"position": [[0.2, 0.5], [0.3, 0.5]], "radius": 0.1, "fixed": True})[1] == []


def test_periodic_box_must_be_long_enough():
    assert "box: periodic axis 0" in faults({"position": [[0.5, 0.5]], "radius": 0.3}, periodic=[True, False])


def test_allowed_overlap_is_pushed_apart_without_touching_velocities():
    collisions = {"collisions": {"allow_overlap": True}, "walls": {}}
    position = [[0.5, 0.5], [0.5, 0.5], [0.52, 0.5], [0.06, 0.06], [0.07, 0.05], [0.3, 0.3]]
    population = {"position": position, "radius": 0.05, "velocity": [1, 2], "mass": [1, 2, 3, 4, 5, 6]}
    particles, warnings = start(population, effects=collisions)
    assert len(warnings) == 1 and "pairs 0-1, 0-2, 1-2 and 3-4 overlap" in warnings[0]
    assert deepest(particles) <= 1e-12
    assert (particles.velocity == [1, 2]).all()
    assert (particles.position[5] == [0.3, 0.3]).all()
    assert ((particles.position >= 0.05 * (1 - 1e-9)) & (particles.position <= 1 - 0.05 * (1 - 1e-9))).all()
    again, _ = start(population, effects=collisions)
    assert np.array_equal(again.position, particles.position)


@settings(max_examples=100)
@given(st.lists(st.floats(0.0, 2.0), min_size=2, max_size=6), st.sampled_from(["open", "walls", "periodic"]), st.booleans())
def test_rods_on_a_line_are_pushed_apart_in_their_order(places, kind, held):
    """Rods cannot pass one another, not even where they overlap at the start; on a ring it is the order round it."""
    population = {"position": [[x + 8.0] for x in places], "radius": 0.4, "fixed": [held] + [False] * (len(places) - 1)}
    effects = {"collisions": {"allow_overlap": True}} | ({"walls": {}} if kind == "walls" else {})
    box = {"d": 1, "upper": 20.0, "periodic": kind == "periodic"}
    particles, _ = start(population, effects=effects, step=1e-6, **box)
    order, x = np.argsort(np.add(places, 8.0), kind="stable"), particles.position[:, 0]
    apart = np.diff(x[order])
    if kind == "periodic":
        apart = np.mod(np.append(apart, x[order[0]] - x[order[-1]]), 20.0)
        assert apart.sum() == pytest.approx(20.0)
    assert apart.min() >= 0.8 * (1.0 - 1e-9)
    assert not held or x[0] == places[0] + 8.0


def test_fixed_spheres_are_not_pushed_and_lighter_ones_move_further():
    collisions = {"collisions": {"allow_overlap": True}}
    particles, _ = start({"position": [[0.5, 0.5], [0.55, 0.5]], "radius": 0.05, "fixed": [True, False]}, effects=collisions)
    assert particles.position[0].tolist() == [0.5, 0.5] and np.isclose(particles.position[1, 0], 0.6)
    particles, _ = start({"position": [[0.5, 0.5], [0.55, 0.5]], "radius": 0.05, "mass": [3, 1]}, effects=collisions)
    assert np.isclose(0.5 - particles.position[0, 0], 0.0125) and np.isclose(particles.position[1, 0] - 0.55, 0.0375)


def test_hopeless_overlap_is_a_warning_that_says_how_much_is_left():
    population = {"count": 4, "position": [[0.5, 0.5]] * 4, "radius": 0.4}
    _, warnings = start(population, effects={"collisions": {"allow_overlap": True}, "walls": {}})
    assert "still overlap after 1000 sweeps" in warnings[-1]


def test_very_many_random_spheres_take_seconds():
    start({"count": 100, "position": "random", "radius": 0.001}, d=3)
    begin = time.process_time()
    particles, _ = start({"count": 300_000, "position": "random", "radius": 0.001}, d=3)
    assert len(particles) == 300_000
    assert time.process_time() - begin < 5.0


@pytest.mark.parametrize("position", [[[0.1, 0.2], [0.3]], [[0.1, 0.2], 0.3], "nowhere", 3.0])
def test_added_particles_that_make_no_sense_are_refused_by_key(position):
    sim = Simulation(scene({"position": [[0.5, 0.5]]}, effects={}))
    with pytest.raises(SceneError, match=r"particles\[1\]\.position"):
        sim.add({"position": position})
