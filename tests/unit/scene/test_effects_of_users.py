"""Effects of a student: what was lost, or other than after a restart, without a word."""

import copy
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from particles_mpi import Scene, Simulation
from particles_mpi.errors import SceneError, StoppedError

HEAD = "import numpy as np\nfrom particles_mpi.effects import *\nclass Options(EffectOptions):\n"


def write(folder, body, kind="Force", options="k: float = 1", head="", name="mine"):
    indented = [textwrap.indent(textwrap.dedent(part), "    ") for part in (options, f"formula = 'x'\n{body}")]
    (folder / f"{name}.py").write_text(f"{head}\n{HEAD}{indented[0]}\nclass Effect({kind}):\n{indented[1]}\n")
    return folder / f"{name}.py"


def sim(file, options=None, integrator="leapfrog", effects=None, **more):
    mine = {"mine": {"file": str(file)} | (options or {})}
    tables = {"dimension": 2, "time": {"step": 0.01, "steps": 50, "integrator": integrator}, "effects": mine | (effects or {})}
    particles = more.pop("particles", [{"position": [[1.0, 0.0], [0.0, 2.0]], "velocity": [0.5, 0.0]}])
    return Simulation(Scene.from_dict(tables | {"particles": particles} | more))


def goes_on_as_read_back(one, path, steps=30):
    one.to_json(path)
    other = Simulation.from_json(path)
    for each in (one, other):
        each.steps(steps)
    return one == other


SPRING = "def __init__(s, o, c): s.k = {}\ndef add(s, p, a): a -= s.k * p.position"


@pytest.mark.parametrize("kind", ["VelocityFlow", "Event"])
@pytest.mark.parametrize("integrator", ["order4", "adaptive"])
def test_needs_with_columns_only_leave_the_integrators_of_the_kind(tmp_path, kind, integrator):
    body = "needs = Needs(columns={'dye': Column()})\ndef advance(s, p, h): p.velocity *= 0.5\ndef act(s, p, h): return 0"
    with pytest.raises(SceneError, match="which mine does not allow"):
        sim(write(tmp_path, body, kind), integrator=integrator)


LAW = "import math\nfrom particles_mpi.effects import kernel\nfrom far import F\nK = {}\n"
LAW += "@kernel\ndef pull(x, f=F):\n    return f * {}\n"


def test_a_kernel_is_compiled_anew_if_what_it_imports_has_changed(tmp_path):
    """A number, an expression, a name that has the same bytes of code; and what a helper itself imports."""
    body = "def add(s, p, a): go(p.position, a)"
    imports = "import law\nfrom law import K\nfrom particles_mpi.effects import kernel"
    file = write(tmp_path, body, head=f"import sys\nsys.path.insert(0, __file__.rpartition('/')[0])\n{imports}")
    with file.open("a") as more:
        more.write("@kernel\ndef go(x, a):\n    for i in range(len(x)):\n        a[i, 0] -= K * law.pull(x[i, 0])\n")
    tables = {"dimension": 2, "time": {"step": 0.1, "steps": 1}, "effects": {"mine": {"file": str(file)}}}
    tables["particles"] = [{"position": [[1.0, 0.0]]}]
    script = f"from particles_mpi import Scene, Simulation\nprint(Simulation(Scene.from_dict({tables!r})).sum_forces()[0, 0])"
    said = []
    for number, power, far in ((1, "math.sin(x)", 1), (1, "math.cos(x)", 1), (3, "math.cos(x)", 1), (3, "math.cos(x)", 2)):
        (tmp_path / "law.py").write_text(LAW.format(float(number), power))
        (tmp_path / "far.py").write_text(f"F = {float(far)}\n")
        said.append(float(subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout))
    assert said == pytest.approx([-np.sin(1.0), -np.cos(1.0), -3.0 * np.cos(1.0), -6.0 * np.cos(1.0)])


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        ("Event", "def __init__(s, o, c): s.g = 9.81\ndef act(s, p, h): return 0"),
        ("VelocityFlow", "def __init__(s, o, c): s.g = 9.81\ndef advance(s, p, h): p.velocity[:, 1] -= s.g * h"),
        (
            "Force",
            "def law(s, r): return r\ndef __init__(s, o, c): s.law = lambda r: 2 * r\ndef add(s, p, a): a -= s.law(p.position)",
        ),
    ],
)
def test_names_of_the_effect_of_its_own_are_free(tmp_path, kind, body):
    sim(write(tmp_path, body, kind)).step()


@pytest.mark.parametrize("name", ["spin", "moment_of_inertia", "orientation"])
@pytest.mark.parametrize("mode", ["rewind", "event"])
def test_an_effect_may_turn_smooth_spheres(tmp_path, name, mode):
    """Nothing else does; a moment of inertia is that of a disc, unless it is given."""
    head = "from particles_mpi.particles import FIELDS"
    file = write(tmp_path, f"needs = Needs(columns={{'{name}': FIELDS['{name}']}})\ndef add(s, p, a): a -= 1.0", head=head)
    some = {"position": [[1.0, 0.0], [0.0, 2.0]], "radius": 0.1, "mass": 3.0}
    given = {"spin": 2.0} if name == "spin" else {}
    one = sim(file, effects={"collisions": {"mode": mode}}, particles=[some | given])
    one.steps(3)
    assert one.rows["spin"].tolist() == [[2.0 * (name == "spin")]] * 2
    assert one.rows["moment_of_inertia"] == pytest.approx(np.full(2, 0.5 * 3.0 * 0.1**2), rel=1e-15)


def test_a_default_may_be_nan(tmp_path):
    body = "needs = Needs(columns={'not_set': Column(default=float('nan'))})\ndef add(s, p, a): pass"
    assert np.isnan(sim(write(tmp_path, body)).particles.not_set).all()


def test_nobody_has_an_energy_of_any_shape(tmp_path):
    body = "def add(s, p, a): pass\ndef potential(s, p): return (p.position**2).sum(axis=1) if len(p) else 0.0"
    assert sim(write(tmp_path, body), particles=[]).measure()["potential"] == 0.0


def test_a_flow_for_no_integrator_that_knows_flows_is_refused(tmp_path):
    body = "needs = Needs(integrators=('order4',))\ndef advance(s, p, h): pass"
    with pytest.raises(SceneError, match="works with leapfrog and taylor only"):
        sim(write(tmp_path, body, "VelocityFlow"))


def test_an_effect_that_reads_options_of_another_one_sees_them_change(tmp_path):
    reader = write(tmp_path, SPRING.format("c.effects['other'].k"))
    other = write(tmp_path, SPRING.format("o.k"), name="other")
    s = sim(reader, effects={"other": {"file": str(other)}})
    s.effects["other"].k = 5.0
    assert goes_on_as_read_back(s, tmp_path / "s.json")


def test_an_option_that_is_none_stays_none(tmp_path):
    s = sim(write(tmp_path, SPRING.format("o.k or 0.0"), options="k: float | None = 2.5"))
    s.effects["mine"].k = None
    assert goes_on_as_read_back(s, tmp_path / "s.json")


@pytest.mark.parametrize(
    "options, head, given",
    [
        (
            "k: Annotated[float, AfterValidator(radians)]",
            "from math import radians\nfrom typing import Annotated\nfrom pydantic import AfterValidator",
            90.0,
        ),
        ("k: date", "from datetime import date", __import__("datetime").date(2020, 1, 2)),
        ("k: float = '1.0'", "", None),
    ],
)
def test_options_that_a_checkpoint_would_not_give_back_are_refused_at_the_start(tmp_path, options, head, given):
    file = write(tmp_path, SPRING.format("1.0"), options=options, head=head)
    with pytest.raises(SceneError, match=r"^effects\.mine\.file: option k: .*checkpoint"):
        sim(file, {} if given is None else {"k": given})


def test_a_part_of_an_option_cannot_be_set(tmp_path):
    options = "m: list[list[float]] = [[1]]\nd: dict[str, float] = {'a': 1}\nt: Table = Table()"
    head = "from pydantic import BaseModel\nclass Table(BaseModel):\n    x: float = 1"
    walls = {"planes": [{"point": [-9.0, 0.0], "normal": [1.0, 0.0]}]}
    s = sim(write(tmp_path, SPRING.format("o.m[0][0]"), options=options, head=head), effects={"walls": walls})
    for change in (lambda e: e["mine"].m[0].__setitem__(0, 9.0), lambda e: e["mine"].d.__setitem__("a", 9.0),
                   lambda e: e["walls"].planes[0].point.__setitem__(0, 0.9), lambda e: setattr(e["mine"].t, "x", 5.0),
                   lambda e: setattr(e["walls"].planes[0], "point", [0.9, 0.0])):  # fmt: skip
        with pytest.raises((TypeError, AttributeError)):
            change(s.effects)
    s.effects["mine"].d = {**s.effects["mine"].d, "b": 2.0}
    assert goes_on_as_read_back(s, tmp_path / "s.json")


def test_a_table_within_an_option_can_be_set_as_it_is_read(tmp_path):
    """None in it, too, outlasts JSON, where that is not what it would be if it were not given."""
    options = "t: Table = Table()"
    head = "from pydantic import BaseModel\nclass Table(BaseModel):\n    x: float | None = 0.5"
    floor, ceiling = {"point": [0.0, -9.0], "normal": [0.0, 1.0]}, {"point": [0.0, 9.0], "normal": [0.0, -1.0]}
    s = sim(write(tmp_path, SPRING.format("o.t.x or 0.1"), options=options, head=head), effects={"walls": {"planes": [floor]}})
    walls, mine = s.effects["walls"], s.effects["mine"]
    walls.planes = [*walls.planes, ceiling]
    assert len(walls.planes) == 2 and copy.copy(walls.planes[0]) == walls.planes[0]
    mine.t = mine.t
    mine.t = {"x": None}
    assert goes_on_as_read_back(s, tmp_path / "s.json")


@pytest.mark.parametrize("where", ["__init__(s, o, c)", "bind(s, c)"])
@pytest.mark.parametrize("kind", ["Force", "VelocityFlow"])
def test_an_option_that_is_refused_changes_nothing(tmp_path, where, kind):
    flow = "def advance(s, p, h): p.velocity *= 1 - s.k * h"
    body = f"def __init__(s, o, c): s.k = o.k\ndef add(s, p, a): a -= s.k * p.position\n{flow}\ndef {where}:\n    "
    body += ("s.k = o.k\n    " if "o" in where else "") + "if s.k > 5: raise FileNotFoundError('table')"
    s = sim(write(tmp_path, body, kind))
    s.steps(3)
    with pytest.raises((SceneError, StoppedError), match=r"effects\.mine"):
        s.effects["mine"].k = 9.0
    assert s.effects["mine"].k == 1
    assert goes_on_as_read_back(s, tmp_path / "s.json")


def test_a_flow_does_not_turn_who_is_fixed(tmp_path):
    s = sim(write(tmp_path, "def advance(s, p, h): p['spin'][:] += h", "VelocityFlow"), effects={"collisions": {"friction": 0.5}},
            particles=[{"position": [[0.0, 0.0], [3.0, 0.0]], "radius": 0.5, "fixed": [True, False]}])  # fmt: skip
    s.steps(10)
    assert s.particles.spin[s.particles.fixed].max() == 0.0 and s == s.copy()


@pytest.mark.parametrize(
    "body",
    [
        "def add(s, p, a):\n    r = p.position\n    r -= 0.5",
        "def add(s, p, a): pass\ndef potential(s, p):\n    r = p.position\n    r *= r\n    return r[:, 0]",
    ],
)
def test_a_force_that_moves_particles_is_stopped(tmp_path, body):
    s = sim(write(tmp_path, body))
    with pytest.raises(StoppedError, match=r"^effects\.mine: its `(add|potential)` failed: ValueError: .*read-only"):
        s.measure()
        s.step()


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        ("VelocityFlow", "def advance(s, p, h): p.position += h"),
        ("VelocityFlow", "def rate(s, p):\n    p.position += 1.0\n    return 0.0 * p.velocity\ndef advance(s, p, h): pass"),
        ("VelocityFlow", "def advance(s, p, h): p['id'][:] = p.id[::-1]"),
        ("Event", "def act(s, p, h):\n    p.id += 1\n    return 1"),
    ],
)
def test_a_flow_that_moves_particles_is_stopped_and_whatever_changes_ids(tmp_path, kind, body):
    with pytest.raises(StoppedError, match=r"^effects\.mine: its `(advance|rate|act)` failed: ValueError: .*read-only"):
        sim(write(tmp_path, body, kind), integrator="taylor" if "rate" in body else "leapfrog").step()


@pytest.mark.parametrize("returned", ["float((p.position**2).sum())", "p.position", "p.position[:, :1]"])
def test_a_potential_is_a_number_for_each(tmp_path, returned):
    with pytest.raises(StoppedError, match=r"^effects\.mine: its `potential` returned"):
        sim(write(tmp_path, f"def add(s, p, a): pass\ndef potential(s, p): return {returned}")).measure()


@pytest.mark.parametrize("name", ["speed", "time", "step", "count", "dimension", "arrays", "x", "vy", "_hidden", "Points"])
def test_a_column_has_no_name_that_means_something_else(tmp_path, name):
    with pytest.raises(SceneError, match="the name is taken"):
        sim(write(tmp_path, f"needs = Needs(columns={{'{name}': Column()}})\ndef add(s, p, a): pass"))


def test_an_effect_may_need_a_column_of_the_program(tmp_path):
    """It has what the population or the program's own effect gives, with that effect and without."""
    names = "drag", "radius", "mass", "acceleration"
    columns = f"{{name: FIELDS[name] for name in {names}}}"
    file = write(
        tmp_path,
        f"needs = Needs(columns={columns})\ndef add(s, p, a): a -= 1.0",
        head="from particles_mpi.particles import FIELDS",
    )
    two = [{"position": [[1.0, 0.0], [0.0, 2.0]], "radius": [0.1, 0.2], "mass": 3.0}]
    for given, effects, drag in (
        ({}, {"drag": {"rate": 0.5}}, [0.5, 0.5]),
        ({"drag": [0.1, 0.2]}, {}, [0.1, 0.2]),
        ({}, {}, [0, 0]),
    ):
        rows = sim(file, effects=effects, particles=[two[0] | given]).rows
        assert rows["drag"].tolist() == drag and rows.radius.tolist() == [0.1, 0.2] and rows.mass.tolist() == [3.0, 3.0]


@pytest.mark.parametrize("column", ["'int64', default=0.5", "'uint8', default=-1", "default='1'", "default=-1.0, least=0.0"])
def test_a_default_is_a_value_of_its_column(tmp_path, column):
    with pytest.raises(SceneError, match="its default"):
        sim(write(tmp_path, f"needs = Needs(columns={{'odd': Column({column})}})\ndef add(s, p, a): pass"))


@pytest.mark.parametrize("value", [1e60, [1.0, 3.5e38], {"min": 0.0, "max": 1e60}])
def test_no_value_of_a_column_is_beyond_its_numbers(tmp_path, value):
    file = write(tmp_path, "needs = Needs(columns={'odd': Column('float32')})\ndef add(s, p, a): pass")
    two = {"position": [[1.0, 0.0], [0.0, 2.0]]}
    with pytest.raises(SceneError, match=r"particles\[0\]\.odd: beyond 3\.40282e\+38 for particle"):
        sim(file, particles=[two | {"odd": value}])
    with pytest.raises(SceneError, match=r"particles\[1\]\.odd: beyond 3\.40282e\+38 for particle"):
        sim(file, particles=[two]).add(two | {"odd": value})


def test_names_of_the_program_in_an_effect_are_refused(tmp_path):
    with pytest.raises(SceneError, match=r"effects\.mine\.file: self\.g is used by the program itself"):
        sim(write(tmp_path, "def __init__(s, o, c): s.g = o.k\ndef add(s, p, a): a -= s.g * p.position"))


def test_a_force_and_flow_in_one_is_changed_as_a_whole(tmp_path):
    s = sim(write(tmp_path, SPRING.format("o.k") + "\ndef advance(s, p, h): p.velocity *= 1 - s.k * h", "Force, VelocityFlow"))
    s.effects["mine"].k = 9.0
    assert goes_on_as_read_back(s, tmp_path / "s.json")


@pytest.mark.parametrize("method, kind", [("add(s, p)", "Force"), ("act(s, p)", "Event"), ("advance(s, p)", "VelocityFlow")])
def test_what_fails_in_a_method_names_the_effect(tmp_path, method, kind):
    with pytest.raises(StoppedError, match=r"^effects\.mine: its `\w+` failed: TypeError"):
        sim(write(tmp_path, f"def {method}: pass", kind)).step()
