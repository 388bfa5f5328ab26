"""An effect is one file: a force, a velocity flow and an event from outside the package, each with a column of its own."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import run_ranks
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOHDF import vtkHDFReader
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

from particles_mpi import Run, Scene, SceneError, Simulation, StoppedError
from particles_mpi.initial.populate import populate
from particles_mpi.study.recommend.runs import variant

OUTSIDE = Path(__file__).parent / "outside"
BOX = """
dimension = 3
[box]
lower = [0, 0, 0]
upper = [6, 6, 6]
[time]
step = 0.01
steps = 60
[[particles]]
count = 120
position = "random"
velocity = {speed = {min = 1.0, max = 5.0}}
radius = {min = 0.1, max = 0.2}
mass = {min = 0.5, max = 2.0}
OWN
[output]
every = 20
[effects.walls]
restitution = 0.9
[effects.collisions]
mode = "MODE"
restitution = 0.95
"""
OWN = {
    "magnetic_field": ("charge = {min = -1.0, max = 1.0}", 'file = "magnetic.py"\nfield = [0.5, 0.0, 2.0]'),
    "springs": ("stiffness = {min = 0.0, max = 3.0}", 'file = "springs.py"\ncentre = [3.0, 3.0, 3.0]'),
    "repulsion": ("hardness = {min = 0.5, max = 3.0}", 'file = "repulsion.py"\nreach = 0.8'),
    "gate": ("", 'file = "gate.py"\nplace = 3.0'),
}
COLUMNS = {"magnetic_field": "charge", "springs": "stiffness", "repulsion": "hardness", "gate": "crossings"}


def text(mode, *names):
    columns = "\n".join(OWN[name][0] for name in names)
    tables = "".join(f"[effects.{name}]\n{OWN[name][1]}\n" for name in names)
    return BOX.replace("MODE", mode).replace("OWN", columns) + tables


def scene(table, d=3, **more):
    """One particle, and one effect from a file of this folder."""
    time = {"step": 0.01, "steps": 100} | more.pop("time", {})
    particles = [{"position": [[1.0] * d], "velocity": [1.0] + [0.5] * (d - 1)} | more.pop("particle", {})]
    return Scene.from_dict({"dimension": d, "time": time, "particles": particles, "effects": table} | more, OUTSIDE)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Each effect alone and all together, in both modes, on 1 and 2 ranks; a folder with what they left."""
    folder = tmp_path_factory.mktemp("outside")
    for path in OUTSIDE.glob("*.py"):
        shutil.copy(path, folder)
    for mode in ("rewind", "event"):
        for name in OWN:
            (folder / f"{name}_{mode}.toml").write_text(text(mode, name))
        (folder / f"all_{mode}.toml").write_text(text(mode, *OWN))
    for ranks in (1, 2):
        done = run_ranks(ranks, "tests/parallel/outside_runs.py", folder, timeout=300)
        assert done.returncode == 0, done.stderr[-2000:]
    return folder


@pytest.mark.parametrize("mode", ["rewind", "event"])
def test_a_magnetic_field_does_no_work_between_elastic_contacts_either(mode):
    """Charged spheres of a gas, and between walls, turn by 0.06 in a step: energy to round-off after a thousand contacts."""
    particle = {
        "position": "lattice",
        "count": 64,
        "velocity": {"temperature": 1.0},
        "radius": 0.4,
        "charge": {"min": 1, "max": 2},
    }
    box = {"lower": [0.0] * 3, "upper": [4.0] * 3, "periodic": [True, True, False]}
    field = {"file": "magnetic.py", "field": [1.0, 0.0, 3.0]}
    sim = Simulation(scene({"magnetic_field": field, "collisions": {"mode": mode}, "walls": {}}, particle=particle, box=box))
    energy = sim.measure()["kinetic"]
    while sim.totals["collisions"] < 1000:
        sim.step()
        assert sim.measure()["kinetic"] == pytest.approx(energy, rel=1e-12)
    assert sim.totals["wall_hits"] > 100


CASES = [f"{name}_{mode}" for mode in ("rewind", "event") for name in (*OWN, "all")]


@pytest.mark.parallel
@pytest.mark.parametrize("case", CASES)
def test_same_bits_on_ranks_and_after_a_restart(runs, case):
    one, two = (dict(np.load(runs / f"{case}.{ranks}.npz")) for ranks in (1, 2))
    assert [name for name in one if one[name].tobytes() != two[name].tobytes()] == []
    for ranks in (1, 2):
        assert json.loads((runs / f"{case}.{ranks}.json").read_text()) == {"resumed is the same": True}


@pytest.mark.parallel
@pytest.mark.parametrize("name", OWN)
def test_columns_are_in_frames_checkpoints_and_plans(runs, name):
    folder, column = runs / f"{name}_rewind.2", COLUMNS[name]
    with h5py.File(folder / "trajectory.vtkhdf") as file:
        last = file[f"VTKHDF/PointData/{column}"][-120:]
    final = dict(np.load(runs / f"{name}_rewind.2.npz"))[column]
    assert np.unique(last).size > 1 and np.unique(final).size > 1
    if name != "gate":  # which changes its column
        np.testing.assert_array_equal(last, final)
    run = json.loads((folder / "run.json").read_text())
    (row,) = (row for row in run["plan"]["effects"] if row["effect"] == name)
    assert row["calls"] > 0 and row["law"]
    assert run["scene"]["effects"][name]["file"] == str(runs / f"{OWN[name][1].split(chr(34))[1]}")


def test_a_charge_goes_round_exactly():
    """The velocity turns by q B t/m about B, whatever the step; the place follows with the order of leapfrog."""
    table = {"magnetic_field": {"file": "magnetic.py", "field": [0.0, 0.0, 2.0]}}
    errors = []
    for steps in (100, 200):
        time = {"step": 1.0 / steps, "steps": steps}
        sim = Simulation(scene(table, time=time, particle={"charge": 1.5, "mass": 0.5, "velocity": [1.0, 0.0, 0.3]}))
        sim.run()
        omega = -1.5 * 2.0 / 0.5
        np.testing.assert_allclose(sim.particles.velocity[0], [np.cos(omega), np.sin(omega), 0.3], atol=1e-13)
        true = [1.0 + np.sin(omega) / omega, 1.0 + (1.0 - np.cos(omega)) / omega, 1.3]
        errors.append(np.abs(sim.particles.position[0] - true).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.05)


def test_two_flows_together_are_of_second_order():
    """Two fields, as two effects, each exact by itself: the velocity turns about their sum."""
    start, field, errors = np.array([1.0, 0.5, 0.3]), np.array([0.6, 0.0, 0.8]), []
    table = {name: {"file": "magnetic.py", "field": (field * axis).tolist()} for name, axis in zip("xz", np.eye(3)[[0, 2]])}
    angle, cross = -1.5 / 0.5, np.cross(field, start)  # |B| = 1
    true = start * np.cos(angle) + cross * np.sin(angle) + field * (field @ start) * (1.0 - np.cos(angle))
    for steps in (20, 40):
        time = {"step": 1.0 / steps, "steps": steps}
        sim = Simulation(scene(table, time=time, particle={"charge": 1.5, "mass": 0.5, "velocity": start.tolist()}))
        sim.run()
        errors.append(np.abs(sim.particles.velocity[0] - true).max())
    assert errors[1] < 1e-4 and np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.05)


def test_a_wall_reflects_the_velocity_of_the_moment_of_contact():
    """In a field along the wall the path is made of arcs; a bounce keeps the order of the step, and the speed."""
    table = {"magnetic_field": {"file": "magnetic.py", "field": [0.0, 0.0, 1.0]}, "walls": {"planes": [
        {"point": [0.0, 0.0, 0.0], "normal": [1.0, 0.0, 0.0]}]}}  # fmt: skip
    ends = []
    for steps in (40, 80, 160, 5120):
        time = {"step": 2.0 / steps, "steps": steps}
        sim = Simulation(scene(table, time=time, particle={"velocity": [-1.0, 0.2, 0.0], "radius": 0.1}))
        sim.run()
        assert np.linalg.norm(sim.particles.velocity[0]) == pytest.approx(np.hypot(1.0, 0.2), rel=1e-3)
        ends.append(sim.particles.position[0].copy())
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    assert errors[0] / errors[2] > 10.0  # 16 for order two


def test_springs_keep_the_energy_and_the_period():
    table = {"springs": {"file": "springs.py", "centre": [0.0, 0.0]}}
    sim = Simulation(scene(table, d=2, time={"step": 0.001, "steps": 3142}, particle={"stiffness": 8.0, "mass": 2.0}))
    energy = sim.measure()["total_energy"]
    assert energy == pytest.approx(0.5 * 2.0 * 1.25 + 0.5 * 8.0 * 2.0)
    sim.run()
    np.testing.assert_allclose(sim.particles.position[0], [1.0, 1.0], atol=2e-3)  # one period is pi
    assert sim.measure()["total_energy"] == pytest.approx(energy, rel=1e-5)


@pytest.mark.parametrize("periodic", [True, False])
def test_what_repels_one_another_keeps_momentum_and_energy(periodic):
    particle = {"count": 27, "position": "lattice", "velocity": {"temperature": 1.0}, "hardness": {"min": 1.0, "max": 9.0}}
    box, table = {"lower": [0.0] * 3, "upper": [3.0] * 3, "periodic": periodic}, {"file": "repulsion.py", "reach": 1.4}
    sim = Simulation(scene({"repulsion": table}, particle=particle, box=box, time={"step": 0.001, "steps": 400}))
    p, before = sim.particles, sim.measure()
    momentum = (p.mass[:, None] * p.velocity).sum(axis=0)
    sim.run()
    p, after = sim.particles, sim.measure()
    assert abs(after["kinetic"] - before["kinetic"]) > 0.1
    assert after["total_energy"] == pytest.approx(before["total_energy"], rel=1e-4)
    np.testing.assert_allclose((p.mass[:, None] * p.velocity).sum(axis=0), momentum, atol=1e-13)


KICKS = """
from particles_mpi.effects import EffectOptions, Event
class Options(EffectOptions): pass
class Effect(Event):
    formula = "v = v + 0.1"
    def act(self, particles, h):
        particles.velocity += 0.1
        return len(particles)
"""


WIND = """
from particles_mpi.effects import EffectOptions, VelocityFlow
class Options(EffectOptions): pass
class Effect(VelocityFlow):
    formula = "dv/dt = 10"
    def advance(self, particles, h):
        particles.velocity += 10.0 * h
"""
PULL = """
from particles_mpi.effects import EffectOptions, Force
class Options(EffectOptions): pass
class Effect(Force):
    formula = "dv/dt = 10"
    def add(self, particles, acceleration):
        acceleration += 10.0
"""


@pytest.mark.parametrize("mode", ["rewind", "event"])
@pytest.mark.parametrize("lines", [KICKS, WIND, PULL], ids=["event", "flow", "force"])
def test_an_effect_moves_nobody_who_is_fixed(tmp_path, lines, mode):
    (tmp_path / "kicks.py").write_text(lines)
    particle = {"position": [[0.0, 0.0], [2.0, 0.0]], "velocity": [0.0, 0.0], "fixed": [True, False], "radius": 0.1}
    effects = {"kicks": {"file": str(tmp_path / "kicks.py")}, "collisions": {"mode": mode}}
    sim = Simulation(scene(effects, d=2, particle=particle))
    sim.steps(50)
    assert not sim.particles.position[0].any() and sim.particles.velocity[0].tolist() == [0.0, 0.0]
    assert sim.particles.velocity[1, 0] == pytest.approx(5.0)
    again = sim.copy()
    again.particles.mass[:] = again.particles.mass  # a change that changes nothing
    for one in (sim, again):
        one.steps(5)
    assert sim == again


@pytest.mark.parametrize("mode", ["rewind", "event"])
def test_what_an_event_does_is_not_finished_as_a_bounce(tmp_path, mode):
    """Two meet under their attraction, and stop at once: no closing kick of the bounce comes after that."""
    (tmp_path / "stops.py").write_text(KICKS.replace("+= 0.1", "*= 0.0"))
    pair = {"position": [[-0.505, 0.0], [0.505, 0.0]], "velocity": [[1.0, 0.0], [-1.0, 0.0]], "radius": 0.5, "mass": 4.0}
    effects = {"mutual_gravity": {"G": 1.0}, "collisions": {"mode": mode}, "stops": {"file": str(tmp_path / "stops.py")}}
    sim = Simulation(scene(effects, d=2, particle=pair))
    sim.step()
    assert sim.totals["collisions"] == 1
    apart = np.ptp(sim.particles.position[:, 0])
    assert sim.particles.velocity[:, 0] == pytest.approx([0.5 * 0.01 * 4.0 / apart**2, -0.5 * 0.01 * 4.0 / apart**2], rel=1e-12)


def test_a_start_table_gives_columns_of_effects_too(tmp_path):
    """And those of the program's own; what the scene says goes before."""
    (tmp_path / "start.csv").write_text("x,y,Stiffness,drag,other\n0.5,0.6,3,0.1,7\n1.5,1.6,4,0.2,8\n")
    springs = {"file": str(OUTSIDE / "springs.py"), "centre": [0.0, 0.0]}
    for more, drag in (({}, [0.1, 0.2]), ({"drag": 0.5}, [0.5, 0.5])):
        tables = {"dimension": 2, "time": {"step": 0.01, "steps": 1}, "particles": [{"position": {"file": "start.csv"}} | more]}
        sim = Simulation(Scene.from_dict(tables | {"effects": {"springs": springs, "drag": {}}}, tmp_path))
        assert sim.particles["stiffness"].tolist() == [3.0, 4.0] and sim.particles["drag"].tolist() == drag
        assert "columns other of" in sim.warnings[0] and len(sim.warnings) == 1 + len(more)
    (tmp_path / "start.csv").write_text("x,y,stiffness\n0.5,0.6,-3\n")
    with pytest.raises(SceneError, match=r"stiffness: below 0 for particle 0"):
        Simulation(Scene.from_dict(tables | {"effects": {"springs": springs, "drag": {}}}, tmp_path))


def test_energy_of_a_force_between_pairs_is_that_of_the_pairs_with_a_fixed_one_too():
    """h h' (reach - r)^2/2 of the pair, and the total stays."""
    pair = {"position": [[0.0, 0.0], [0.9, 0.0]], "velocity": [[0.0, 0.0], [-0.5, 0.0]], "fixed": [True, False], "hardness": 2.0}
    sim = Simulation(
        scene({"repulsion": {"file": "repulsion.py", "reach": 1.0}}, d=2, particle=pair, time={"step": 1e-3, "steps": 800})
    )
    for _ in range(8):
        row, r = sim.measure(), np.ptp(sim.particles.position[:, 0])
        assert row["potential"] == pytest.approx(2.0 * (1.0 - r) ** 2, rel=1e-12)
        assert row["total_energy"] == pytest.approx(0.145, rel=1e-5)
        sim.steps(100)


def test_a_fixed_particle_where_the_energy_is_not_finite_does_not_count(tmp_path):
    """As a sun that is shown at the origin of a force."""
    source = (OUTSIDE / "springs.py").read_text().replace("return 0.5 * ", "return -1.0 / ")
    (tmp_path / "sun.py").write_text(source)
    pair = {"position": [[0.0, 0.0], [1.0, 0.0]], "fixed": [True, False], "stiffness": [1.0, 1.0]}
    tables = {"dimension": 2, "time": {"step": 0.01, "steps": 1}, "particles": [pair]}
    sim = Simulation(Scene.from_dict(tables | {"effects": {"sun": {"file": "sun.py", "centre": [0.0, 0.0]}}}, tmp_path))
    with np.errstate(divide="ignore"):
        assert sim.measure()["potential"] == -1.0


def test_a_start_table_gives_vectors_of_effects(tmp_path):
    """One column a component; half a vector is refused."""
    source = (
        (OUTSIDE / "springs.py").read_text().replace("stiffness", "pull").replace("Column(least", "Column(vector=True, least")
    )
    (tmp_path / "wind.py").write_text(source)
    tables = {"dimension": 2, "time": {"step": 0.01, "steps": 1}, "particles": [{"position": {"file": "start.csv"}}]}
    tables |= {"effects": {"wind": {"file": "wind.py", "centre": [0.0, 0.0]}}}
    (tmp_path / "start.csv").write_text("pull_y,x,y,pull_x\n4,0.5,0.6,3\n6,1.5,1.6,5\n")
    particles, _ = populate(Scene.from_dict(tables, tmp_path))
    assert particles["pull"].tolist() == [[3.0, 4.0], [5.0, 6.0]]
    (tmp_path / "start.csv").write_text("x,y,pull_x\n0.5,0.6,3\n")
    with pytest.raises(SceneError, match="its header has pull_x, but no pull_y"):
        populate(Scene.from_dict(tables, tmp_path))


def test_a_study_switches_an_effect_off():
    given = scene(
        {"springs": {"file": "springs.py", "centre": [0.0, 0.0]}, "drag": {}}, d=2, particle={"stiffness": 8.0, "drag": 0.1}
    )
    for name, left in (("springs", "drag"), ("drag", "springs")):
        without = variant(given, {"steps": 3}, {name: {"active": False}})
        Simulation(without).run()
        assert [*without.active] == [left]


def test_a_gate_takes_its_part_once():
    sim = Simulation(scene({"gate": {"file": "gate.py", "place": 1.5}}, d=1, particle={"velocity": [1.0]}))
    sim.run()
    assert sim.particles["crossings"][0] == 1 and sim.particles.velocity[0, 0] == 0.5


@pytest.mark.parametrize(
    ("table", "more", "fault"),
    [
        ({"field": [0, 0, 1]}, {}, "effects.magnetic_field: unknown effect"),
        ({"file": "none.py", "field": [0.0, 0.0, 1.0]}, {}, "effects.magnetic_field.file: .*none.py: no such Python file"),
        ({"file": "magnetic.py"}, {}, "effects.magnetic_field.field: missing"),
        ({"file": "magnetic.py", "field": [1.0]}, {}, "effects.magnetic_field.field: 1 components, not 3"),
        ({"file": "magnetic.py", "field": [0.0] * 3, "B": 1}, {}, "effects.magnetic_field.B: unknown key"),
        ({"file": "magnetic.py", "field": [0.0] * 3}, {"charge": "x"}, r"particles\[0\].charge: must be a number"),
        (
            {"file": "magnetic.py", "field": [0.0] * 3},
            {"change": 1.0},
            r"particles\[0\].change: unknown key .did you mean 'charge'",
        ),
        ({"file": "magnetic.py", "field": [0.0] * 3}, {"charge": [1.0, 2.0]}, r"particles\[0\].charge: 2 entries"),
        (
            {"file": "magnetic.py", "field": [0.0] * 3},
            {"mass": 0.0},
            r"particles\[0\].mass: \[effects.magnetic_field\] divides by it, so it must be above 0",
        ),
    ],
)
def test_every_key_is_checked(table, more, fault):
    with pytest.raises(SceneError, match=fault):
        Simulation(scene({"magnetic_field": table}, particle=more))


@pytest.mark.parametrize("mode", ["event", "rewind"])
def test_a_bounce_under_a_force_is_the_same_across_the_face_of_a_periodic_box(mode):
    found = []
    for shift in (0.0, 4.0):
        places = [[(x + shift + 4.0) % 8.0 - 4.0, y] for x, y in ((-1.0, 0.1), (1.0, 0.0))]
        pair = {"position": places, "velocity": [[2.0, 0.0], [-2.0, 0.0]], "radius": 0.3, "hardness": 3.0}
        effects = {"repulsion": {"file": "repulsion.py", "reach": 1.0}, "collisions": {"mode": mode}}
        box, time = {"lower": [-4.0, -4.0], "upper": [4.0, 4.0], "periodic": True}, {"step": 0.05, "steps": 30}
        sim = Simulation(scene(effects, 2, box=box, time=time, particle=pair))
        sim.run()
        assert sim.totals["collisions"] == 1
        found.append(sim.particles.velocity[np.argsort(sim.particles.id)])
    np.testing.assert_allclose(found[1], found[0], rtol=0.0, atol=1e-13)


def test_a_range_of_a_column_of_whole_numbers_has_each_of_them():
    many = {"count": 400, "position": "lattice", "crossings": {"min": 2, "max": 5}}
    sim = Simulation(scene({"gate": {"file": "gate.py", "place": 0.0}}, particle=many, box={"lower": [0] * 3, "upper": [9] * 3}))
    found, often = np.unique(sim.particles.crossings, return_counts=True)
    assert found.tolist() == [2, 3, 4, 5] and (np.abs(often - 100) < 40).all()


KINDS = """
from particles_mpi.effects import Column, EffectOptions, Event, Needs

class Options(EffectOptions):
    pass

class Effect(Event):
    formula = "nothing"
    needs = Needs(columns={f"of_{kind}": Column(kind) for kind in TYPES}, integrators=("leapfrog",))

    def act(self, particles, h):
        return 0
"""


def test_viewers_read_columns_of_every_type(tmp_path):
    """VTK skips all columns behind one of a type that it does not know, and meshio writes none."""
    types = ("float64", "float32", "int64", "int32", "int16", "int8", "uint64", "uint32", "uint16", "uint8")
    (tmp_path / "kinds.py").write_text(KINDS.replace("TYPES", str(types)))
    given = {f"of_{kind}": [1, 2, 100] for kind in types}
    particles = [{"position": [[0.0], [1.0], [2.0]]} | given]
    tables = {
        "dimension": 1,
        "time": {"step": 1.0, "steps": 1},
        "particles": particles,
        "effects": {"kinds": {"file": "kinds.py"}},
    }
    Simulation(Scene.from_dict(tables, tmp_path)).run(tmp_path / "out")
    for reader, name in ((vtkHDFReader(), "trajectory.vtkhdf"), (vtkXMLUnstructuredGridReader(), "vtk/particles_000000.vtu")):
        reader.SetFileName(str(tmp_path / "out" / name))
        reader.Update()
        data = reader.GetOutput().GetPointData()
        for kind in types:
            values = vtk_to_numpy(data.GetArray(f"of_{kind}"))
            assert values.dtype == kind and values.tolist() == [1, 2, 100], (name, kind)
    for kind in ("bool", "float16", "complex128"):
        (tmp_path / f"{kind}.py").write_text(KINDS.replace("TYPES", str((kind,))))
        with pytest.raises(SceneError, match=f"column 'of_{kind}': {kind} is not a type that files of frames can have"):
            Scene.from_dict(tables | {"effects": {kind: {"file": f"{kind}.py"}}}, tmp_path)
    given["of_uint8"][0] = 256
    with pytest.raises(SceneError, match="of_uint8: not a whole number of type uint8 for particle 0"):
        Simulation(Scene.from_dict(tables, tmp_path))


def test_what_would_be_ignored_is_refused(tmp_path):
    magnetic = {"file": "magnetic.py", "field": [0.0, 0.0, 1.0]}
    with pytest.raises(SceneError, match='"order4" goes back in time between kicks, which magnetic_field does not allow'):
        scene({"magnetic_field": magnetic}, time={"integrator": "order4"})
    with pytest.raises(SceneError, match='"taylor" cannot compute gate'):
        scene({"gate": {"file": "gate.py", "place": 0.0}}, time={"integrator": "taylor"})
    slow = (OUTSIDE / "magnetic.py").read_text().replace("def rate(", "def other(")
    (tmp_path / "slow.py").write_text(slow)
    with pytest.raises(SceneError, match='"taylor" needs a method `rate` of the effect slow; use "leapfrog"'):
        scene({"slow": magnetic | {"file": str(tmp_path / "slow.py")}}, time={"integrator": "taylor"})
    for wrong in (1.5, [0.5], [2**53], [2**53 + 1], 1e30, {"min": 0.5, "max": 0.6}, {"min": 1e30, "max": 1e31}):
        with pytest.raises(
            SceneError, match=r"particles\[0\]\.crossings: not a whole number of type int64 up to 2\^53 - 1 for particle 0"
        ):
            Simulation(scene({"gate": {"file": "gate.py", "place": 0.0}}, particle={"crossings": wrong}))
    with pytest.raises(SceneError, match=r"effects\.drag\.file: drag is a built-in effect"):
        scene({"drag": {"file": "magnetic.py"}})
    for name, lines, why in [
        ("broken", "1 / 0", "ZeroDivisionError"),
        ("empty", "", r"needs a class Options"),
        ("ending", "import sys\nsys.exit(5)", "SystemExit: 5"),
        (
            "kind",
            "from particles_mpi.effects import EffectOptions\nclass Options(EffectOptions): pass\nclass Effect: pass",
            "needs a class Effect that is",
        ),
        *(
            (name, (OUTSIDE.parents[2] / f"particles_mpi/effects/{like}.py").read_text(), "a Force, a VelocityFlow or an Event")
            for name, like in (("hard", "collisions"), ("thick", "drag"), ("sticky", "friction"))
        ),
        ("number", (OUTSIDE / "gate.py").read_text().replace('Column("int64")', "1.0"), "must be a table of columns"),
        ("taken", (OUTSIDE / "gate.py").read_text().replace("crossings", "mass"), "column 'mass': the name is taken"),
        *(
            (f"of_{name}", (OUTSIDE / "gate.py").read_text().replace("crossings", name), f"column '{name}': the name is taken")
            for name in ("Points", "time", "index", "speed", "energy", "step", "fields", "count", "axis", "tank_full")
        ),
    ]:
        (tmp_path / f"{name}.py").write_text(lines)
        with pytest.raises(SceneError, match=rf"effects\.{name}\.file: .*{name}\.py: .*{why}"):
            scene({name: {"file": str(tmp_path / f"{name}.py")}})


@pytest.mark.parallel
def test_a_force_that_does_not_say_that_it_exchanges_messages_ends_with_one_line(tmp_path):
    """It went on, and waited for ever for a rank on which nobody had moved."""
    lines = (OUTSIDE / "repulsion.py").read_text()
    (tmp_path / "repulsion.py").write_text(lines.replace("    collective = True", "    other = True"))
    (tmp_path / "box.toml").write_text(text("event", "repulsion"))
    done = run_ranks(2, "-m", "particles_mpi", "run", tmp_path / "box.toml", "--output", tmp_path / "out")
    assert done.returncode == 3 and "effects.repulsion: its `add` exchanges messages between ranks" in done.stderr, done.stderr


def test_an_error_in_a_file_names_its_line(tmp_path):
    lines = (OUTSIDE / "springs.py").read_text().splitlines()
    at = next(k for k, line in enumerate(lines) if "def add" in line)
    lines.insert(at + 1, "        [][len(acceleration)]" if "acceleration" in lines[at] else "        [][0]")
    (tmp_path / "springs.py").write_text("\n".join(lines))
    (tmp_path / "box.toml").write_text(text("event", "springs"))
    done = run_ranks(1, "-m", "particles_mpi", "run", tmp_path / "box.toml", "--output", tmp_path / "out")
    assert done.returncode == 3 and f"springs.py:{at + 2} add)" in done.stderr, done.stderr


def test_only_what_a_scene_names_is_loaded():
    script = """
import sys
from particles_mpi import Scene
gate = {"file": "gate.py", "place": 1.0}
Scene.from_dict(dict(dimension=3, time={"step": 1.0, "steps": 1}, particles=[], effects={"gate": gate}))
assert len([m for m in sys.modules if m.startswith("particles_mpi_effect")]) == 1
assert not [m for m in sys.modules if m.startswith("particles_mpi.effects.")]
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=100, cwd=OUTSIDE)


def test_a_column_keeps_its_bound_between_steps():
    """What is refused at the start is refused when it is written while the simulation runs, for every effect's column."""
    sim = Simulation(scene({"springs": {"file": "springs.py", "centre": [0.0, 0.0]}}, d=2, particle={"stiffness": 1.0}))
    sim.particles["stiffness"] = -1.0
    with pytest.raises(StoppedError, match=r"particles\.stiffness: particle 0 on rank 0 was given -1, which is not possible"):
        sim.step()
    sim = Simulation(scene({"springs": {"file": "springs.py", "centre": [0.0, 0.0]}}, d=2, particle={"stiffness": 1.0}))
    sim.particles.mass = 0.0
    with pytest.raises(StoppedError, match=r"particles\.mass: particle 0 on rank 0 was given 0, which is not possible"):
        sim.step()


@pytest.mark.parallel
def test_a_run_goes_on_where_its_folder_has_been_moved_to_and_not_with_another_effect(tmp_path):
    """The kernels that numba has kept beside the file were made for a module of another name."""
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    shutil.copy(OUTSIDE / "magnetic.py", here)
    (here / "scene.toml").write_text(text("event", "magnetic_field"))

    def run(folder, output, *more, fresh=True):
        words = ("run", folder / "scene.toml", "--output", folder / output, "--quiet", *more)
        return run_ranks(1, "-m", "particles_mpi", *words, fresh=fresh)

    assert run(here, "whole", fresh=False).returncode == run(here, "parts", "--steps", 20, fresh=False).returncode == 0
    here.rename(there)
    done = run(there, "parts", "--steps", 40, "--resume", "auto")
    assert done.returncode == 0, done.stderr
    done = run(there, "parts", "--resume", there / "parts" / "checkpoint.h5")
    assert done.returncode == 0, done.stderr
    with h5py.File(there / "whole/checkpoint.h5") as one, h5py.File(there / "parts/checkpoint.h5") as other:
        for name in one["particles"]:
            assert one["particles"][name][:].tobytes() == other["particles"][name][:].tobytes(), name
    file = there / "magnetic.py"
    file.write_text(file.read_text() + "\n# changed")
    done = run(there, "parts", "--resume", "auto")
    assert done.returncode == 2 and "effects.magnetic_field.file: has changed since " in done.stderr, done.stderr


def written(folder, **parts):
    """A file with a force on one axis, some parts of which are as given."""
    lines = {
        "add": "def add(self, particles, a):\n        a -= self.k * particles.position",
        "faults": "def faults(self, scene):\n        return []",
        "options": "k: float = 1.0",
    } | parts
    (folder / "own.py").write_text(
        "from particles_mpi.scene.effect import EffectOptions, Force\n\n\n"
        f"class Options(EffectOptions):\n    {lines['options']}\n    {lines['faults']}\n\n\n"
        'class Effect(Force):\n    formula = "-k x"\n\n    def __init__(self, options, scene):\n        self.k = options.k\n'
        f"    {lines['add']}\n"
    )
    table = {"own": {"file": "own.py"}}
    tables = {"dimension": 1, "time": {"step": 0.1, "steps": 9}, "particles": [{"position": [[1.0]]}], "effects": table}
    return Simulation(Scene.from_dict(tables, folder))


def test_a_file_that_was_changed_is_read_anew_and_a_simulation_keeps_what_it_began_with(tmp_path):
    """As in a notebook, where a file of effects is written again and again."""
    pulled = written(tmp_path)
    pushed = written(
        tmp_path, add="def add(self, particles, a):\n        a += self.k * particles.position", options="k: float = 2.0"
    )
    for sim in (pulled, pushed, pulled.copy()):
        sim.step()
    assert pulled.particles.velocity[0, 0] < 0.0 < pushed.particles.velocity[0, 0]
    assert pulled.scene.digests() != pushed.scene.digests()
    (tmp_path / "own.py").unlink()
    pulled.step()
    with pytest.raises(SceneError, match="no such Python file"):
        Scene.from_dict(pulled.scene.to_dict())


def test_a_state_in_json_is_that_of_the_files_that_it_was_saved_with(tmp_path):
    """As a checkpoint is; two simulations that differ in nothing else are not the same."""
    sim, state = written(tmp_path), tmp_path / "state.json"
    sim.step()
    sim.to_json(state)
    assert Simulation.from_json(state) == sim == sim.copy()
    other = written(tmp_path, add="def add(self, particles, a):\n        a -= 100.0 * self.k * particles.position")
    with pytest.raises(SceneError, match=r"effects\.own\.file: has changed since .*state\.json was written"):
        Simulation.from_json(state)
    assert other != written(tmp_path)


def test_what_a_method_returns_is_not_lost(tmp_path):
    sim = written(tmp_path, add="def add(self, particles, a):\n        return -self.k * particles.position")
    with pytest.raises(StoppedError, match=r"effects.own: its `add` must change the arrays that it is given, and return nothing"):
        sim.step()
    with pytest.raises(SceneError, match=r"effects.own.file: .*own.py: its class Effect, a Force, needs a method `add`"):
        written(tmp_path, add="pass")
    (tmp_path / "count.py").write_text(
        "from particles_mpi.scene.effect import EffectOptions as Options, Event\n\n\n"
        'class Effect(Event):\n    formula = "nothing"\n\n    def act(self, particles, h):\n        pass\n'
    )
    with pytest.raises(SceneError, match="needs a class Options"):
        counts = Scene.from_dict({**sim.scene.to_dict(), "effects": {"count": {"file": "count.py"}}}, tmp_path)
    (tmp_path / "count.py").write_text(
        (tmp_path / "count.py").read_text().replace("EffectOptions as Options", "EffectOptions")
        + "\n\nclass Options(EffectOptions):\n    pass\n"
    )
    counts = Scene.from_dict({**sim.scene.to_dict(), "effects": {"count": {"file": "count.py"}}}, tmp_path)
    with pytest.raises(StoppedError, match=r"effects.count: its `act` returned None, and not the number of particles"):
        Simulation(counts).step()


@pytest.mark.parametrize(
    ("returned", "says"),
    [("'k is odd'", "effects.own.k is odd"), ("1 / 0", "effects.own: its `faults` failed: ZeroDivisionError: division by zero")],
)
def test_faults_of_an_effect_are_one_line(tmp_path, returned, says):
    with pytest.raises(SceneError) as told:
        written(tmp_path, faults=f"def faults(self, scene):\n        return {returned}")
    assert told.value.faults == [says]
    written(tmp_path, faults="def faults(self, scene):\n        pass")


def test_an_effect_that_cannot_be_made_is_one_line(tmp_path):
    """Found before anything runs, as faults are."""
    with pytest.raises(SceneError, match=r"effects.own: it cannot be made: AttributeError: .*no attribute 'k'"):
        Simulation(written(tmp_path, options="stiffness: float = 1.0"))


def test_a_column_with_a_component_for_each_plane_is_read_back(tmp_path):
    (tmp_path / "turning.py").write_text(
        "from particles_mpi.effects import Column, EffectOptions, Event, Needs\n\n\n"
        "class Options(EffectOptions):\n    pass\n\n\n"
        'class Effect(Event):\n    formula = "nothing"\n'
        '    needs = Needs(columns={"twist": Column(rotation=True, default=2.5)})\n\n'
        "    def act(self, particles, h):\n        return 0\n"
    )
    time, output = {"step": 0.1, "steps": 2}, {"every": 1, "formats": ["hdf5"]}
    tables = {"dimension": 2, "time": time, "particles": [{"position": [[1.0, 1.0]]}], "output": output}
    sim = Simulation(Scene.from_dict(tables | {"effects": {"turning": {"file": "turning.py"}}}, tmp_path))
    sim.run(tmp_path / "o")
    assert Run(tmp_path / "o")[-1].twist.tolist() == sim.particles.twist.tolist() == [[2.5]]


def test_particles_have_their_fields_and_no_other():
    """Values for a field, and `*=`, go into the array that the program has; a misspelt name is told."""
    p = Simulation(scene({})).rows
    velocity = p.velocity
    p.velocity *= 0.5
    p.radius = 0.25
    assert p.velocity is velocity and velocity.tolist() == [[0.5, 0.25, 0.25]] and p["radius"].tolist() == [0.25]
    with pytest.raises(AttributeError, match="no field 'velocty'"):
        p.velocty = 1.0
    with pytest.raises(ValueError, match="broadcast"):
        p.mass = [1.0, 2.0]
