"""Observables of a hard-sphere fluid, in both modes, against theory; and that asking for them changes nothing else."""

import csv
from io import StringIO

import numpy as np
import pytest

from particles_mpi import Scene, Simulation


def fluid(density, step, n=1372, **collisions):
    side = (n / density) ** (1 / 3)
    return Scene.from_dict(
        {
            "dimension": 3,
            "seed": 2,
            "box": {"lower": [0.0] * 3, "upper": [side] * 3, "periodic": True},
            "time": {"step": step, "steps": 1},
            "particles": [{"count": n, "position": "lattice", "velocity": {"temperature": 2.0}, "radius": 0.5, "mass": 3.0}],
            "effects": {"collisions": collisions},
            "output": {"observables": True},
        }
    )


@pytest.mark.parametrize(
    ("mode", "gamma_step", "steps"), [({"mode": "event"}, 10.0, 25), ({"mode": "rewind", "passes": 10}, 0.1, 800)]
)
def test_hard_sphere_fluid(mode, gamma_step, steps):
    """Z of Kolafa, Labik, Malijevsky at rho sigma^3 = 0.5, by virial and by rate; Maxwell-Boltzmann within 3 standard errors."""
    n, z, density = 1372, 3.26941, 0.5
    temperature = 2.0 * n / (n - 1)
    rate = 6.0 * (z - 1.0) * np.sqrt(temperature / (np.pi * 3.0))
    sim = Simulation(fluid(density, gamma_step / rate, n, **mode))
    for _ in range(max(1, round(20 / gamma_step))):
        sim.step()
    sim.measure()
    ratios = []
    apart = max(5, round(5 / gamma_step))  # steps between two samples: five collisions of each
    for _ in range(steps // apart):
        for _ in range(apart):
            sim.step()
        ratios.append(moment_ratio(sim))
    row = sim.measure()
    assert row["z_virial"] == pytest.approx(z, rel=0.01)
    assert row["z_rate"] == pytest.approx(z, rel=0.01)
    assert row["temperature"] == pytest.approx(temperature, rel=1e-10)
    assert row["packing"] == pytest.approx(density * np.pi / 6.0, rel=1e-12)
    assert row["collision_rate"] == pytest.approx(rate, rel=0.01)
    assert row["free_time"] * row["collision_rate"] == pytest.approx(1.0)
    assert row["free_path"] == pytest.approx(np.sqrt(8.0 * temperature / (np.pi * 3.0)) / rate, rel=0.02)
    freedom = 3 * (n - 1)
    theory = 5.0 / 3.0 * freedom / (freedom + 2)
    error = np.std(ratios) / np.sqrt(len(ratios))
    assert abs(np.mean(ratios) - theory) < 3.0 * error


def moment_ratio(sim):
    v = sim.particles.velocity - sim.particles.velocity.mean(axis=0)
    square = (v**2).sum(axis=1)
    return (square**2).mean() / square.mean() ** 2


@pytest.mark.parametrize("mode", ["rewind", "event"])
def test_asking_changes_no_bit(mode):
    final = []
    for asked in (False, True):
        tables = fluid(0.3, 0.05, 300, mode=mode).to_dict()
        tables["output"]["observables"] = asked
        sim = Simulation(Scene.from_dict(tables))
        for _ in range(20):
            sim.step()
        assert ("z_virial" in sim.measure()) == asked
        final.append(sim.particles.velocity[np.argsort(sim.particles.id)])
    assert (final[0] == final[1]).all()


def test_rates_are_since_the_last_call():
    sim = Simulation(fluid(0.3, 0.05, 300, mode="event"))
    rows = [sim.measure()]
    counts = [0]
    for _ in range(3):
        for _ in range(10):
            sim.step()
        rows.append(sim.measure())
        counts.append(sim.totals["collisions"])
    assert np.isnan(rows[0]["collision_rate"])
    expected = 2.0 * np.diff(counts) / (300 * 0.5)
    np.testing.assert_allclose([row["collision_rate"] for row in rows[1:]], expected, rtol=1e-12)


def test_a_look_does_not_change_what_a_run_writes(tmp_path):
    scene = fluid(0.3, 0.05, 300, mode="event").to_dict()
    scene["time"]["steps"], scene["output"] = 20, scene["output"] | {"diagnostics_every": 10}
    for name in ("looked_at", "alone"):
        sim = Simulation(Scene.from_dict(scene))
        sim.run(tmp_path / name, steps=10)
        sim.steps(5)
        if name == "looked_at":
            sim.measure()
        sim.run(tmp_path / name, steps=20, resumed=True)
    assert (tmp_path / "alone" / "diagnostics.csv").read_text() == (tmp_path / "looked_at" / "diagnostics.csv").read_text()


def test_pressure_after_some_were_removed():
    """The virial of an interval is that of the collisions in it, whoever was there before."""
    sim = Simulation(fluid(0.3, 0.05, 300, mode="event"))
    sim.steps(40)
    sim.measure()
    sim.remove(np.arange(0, 300, 2))
    before = sim.rows.virial.sum()
    sim.steps(40)
    row = sim.measure()
    wanted = 1.0 + (sim.rows.virial.sum() - before) / (3 * 150 * row["temperature"] * 40 * sim.h)
    assert row["z_virial"] == pytest.approx(wanted, rel=1e-12) and 1.0 < wanted < 3.0


RATES = {"collision_rate", "free_time", "free_path", "z_virial", "z_rate"}


def remove_half(sim):
    sim.remove(np.arange(0, 300, 2))


def add_some(sim):
    sim.add({"position": "random", "count": 100, "radius": 0.5, "mass": 3.0})


def fix_some(sim, fixed=True):
    sim.particles.fixed[sim.particles.id < 30] = fixed
    sim.take_changes()


def fix_and_free(sim):
    fix_some(sim)
    sim.steps(2)
    fix_some(sim, False)


def make_elastic(sim):
    sim.effects["collisions"].restitution = 1.0


def make_larger(sim):
    sim.particles.radius *= 1.01


def make_heavier(sim):
    sim.particles.mass *= 2.0


def switch_collisions(sim):
    sim.effects["collisions"].active = False
    sim.step()
    sim.effects["collisions"].active = True


CHANGES = {
    "removed": (remove_half, None, RATES),
    "added": (add_some, None, RATES),
    "fixed and freed": (fix_and_free, None, RATES),
    "freed": (lambda sim: fix_some(sim, False), fix_some, RATES),
    "elastic": (make_elastic, None, {"z_rate"}),
    "larger": (make_larger, None, {"z_rate"}),
    "heavier": (make_heavier, None, {"z_rate"}),
    "switched off and on": (switch_collisions, None, RATES),
    "a step through one another": (lambda sim: sim.step(collisions=False), None, RATES),
}


def unknown(sim):
    return {name for name, value in sim.measure().items() if np.isnan(value)}


@pytest.mark.parametrize("look", [False, True])
@pytest.mark.parametrize("name", CHANGES)
def test_an_interval_in_which_something_else_collided_has_no_rates(name, look, tmp_path):
    """They are known in the next one, as they are if the change was at a `look`; a copy, and what was saved, tell the same."""
    change, before, told = CHANGES[name]
    sim = Simulation(fluid(0.2, 0.05, 300, mode="event", restitution=0.9 if name == "elastic" else 1.0))
    if before:
        before(sim)
    sim.steps(10)
    if look:
        sim.measure()
        sim.time = 1.3
    if look and name == "fixed and freed":
        fix_some(sim), fix_some(sim, False)
    else:
        change(sim)
    look &= sim.steps_done == 10  # else the interval has begun before the change
    sim.run(tmp_path, steps=sim.steps_done)
    sim.to_json(tmp_path / "s.json")
    for one in (sim.copy(), Simulation.from_json(tmp_path / "s.json"), Simulation.resume(tmp_path / "checkpoint.h5")):
        one.steps(10)
        assert unknown(one) == (set() if look else told)
        one.steps(10)
        assert unknown(one) == set()


def test_rows_of_a_run_have_no_rates_after_a_change(tmp_path):
    sim = Simulation(fluid(0.2, 0.05, 300, mode="event"))
    sim.run(tmp_path, steps=10)
    sim.steps(5)
    remove_half(sim)
    sim.run(tmp_path, steps=30, resumed=True)
    rows = {int(row["step"]): row for row in csv.DictReader(StringIO((tmp_path / "diagnostics.csv").read_text()))}
    rates = {step: np.isnan([float(row[name]) for name in RATES]) for step, row in rows.items()}
    assert not rates[10].any() and rates[20].all() and not rates[30].any()


def test_a_change_within_a_step_is_one_too():
    """`step_to_collision` ends at a collision, before a step is done."""
    sim = Simulation(fluid(0.2, 0.05, 300, mode="event"))
    sim.h = 100.0
    sim.measure()
    for _ in range(10):
        sim.step_to_collision()
    assert sim.steps_done == 0
    remove_half(sim)
    sim.step_to_collision()
    assert unknown(sim) == RATES


def test_a_copy_counts_on_from_the_last_row(tmp_path):
    """The first row of its run has the collisions since the last row of the original, and the rates of that interval."""
    sim = Simulation(fluid(0.2, 0.05, 300, mode="event"))
    sim.run(tmp_path / "first", steps=10, quiet=True)  # with a row at its end
    sim.steps(5)
    sim.to_json(tmp_path / "s.json")
    rows = []
    for number, one in enumerate((sim.copy(), Simulation.from_json(tmp_path / "s.json"), sim)):
        one.run(tmp_path / str(number), steps=17, quiet=True)
        rows.append((tmp_path / str(number) / "diagnostics.csv").read_text())
    first = next(csv.DictReader(StringIO(rows[0])))
    assert rows[0] == rows[1] == rows[2]
    assert float(first["collision_rate"]) == pytest.approx(2.0 * int(first["collisions"]) / (300 * 5 * sim.h), rel=1e-12)


def test_the_clock_is_set_in_full_precision(tmp_path):
    sim = Simulation(fluid(0.2, 0.05, 300, mode="event"))
    sim.measure()
    sim.time = np.float32(0.1)
    assert type(sim.time) is float
    sim.steps(10)
    sim.to_json(tmp_path / "s.json")
    assert sim.copy() == Simulation.from_json(tmp_path / "s.json")
    other = Simulation(fluid(0.2, 0.05, 300, mode="event"))
    other.steps(10)
    assert sim.measure()["collision_rate"] == pytest.approx(other.measure()["collision_rate"], rel=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_fixed_spheres_have_no_temperature(d):
    """Nor a part in any other moment of velocities, though they move relative to all others, which fly along together."""
    movable = {
        "count": 50,
        "position": "random",
        "velocity": {"temperature": 1.0},
        "radius": 0.01,
        "mass": {"min": 1.0, "max": 3.0},
    }
    held = {"count": 20, "position": "random", "radius": 0.01, "mass": 5.0, "fixed": True}
    box, time, output = (
        {"lower": [0.0] * d, "upper": [5.0] * d, "periodic": True},
        {"step": 0.1, "steps": 1},
        {"observables": True},
    )
    scene = Scene(
        dimension=d,
        seed=2,
        box=box,
        time=time,
        particles=[movable, held],
        effects={"collisions": {"mode": "event"}},
        output=output,
    )
    sim = Simulation(scene)
    sim.particles.velocity[~sim.particles.fixed] += 4.0
    row, p = sim.measure(), sim.particles.select(np.flatnonzero(~sim.particles.fixed))
    own = p.velocity - (p.mass[:, None] * p.velocity).sum(axis=0) / p.mass.sum()
    square = (own**2).sum(axis=1)
    assert row["temperature"] == pytest.approx((p.mass * square).sum() / (d * 49), rel=1e-12)
    assert row["moment_ratio"] == pytest.approx((square**2).mean() / square.mean() ** 2, rel=1e-12)


def test_what_has_no_meaning_is_not_a_number():
    """A hit of a fixed sphere is one collision of one particle, not of two; and z_rate is that of elastic spheres."""
    lossy = Simulation(fluid(0.3, 0.05, 300, mode="event", restitution=0.9))
    scene = fluid(0.3, 0.05, 300, mode="event").to_dict()
    scene["particles"].append({"position": [[0.0, 0.0, 0.0]], "radius": 0.1, "fixed": True})
    scene["particles"][0]["radius"] = 0.4
    rows = []
    for sim in (lossy, Simulation(Scene.from_dict(scene))):
        sim.measure()
        sim.steps(10)
        rows.append({name for name, value in sim.measure().items() if np.isnan(value)})
    assert rows == [{"z_rate"}, {"collision_rate", "free_time", "free_path", "z_virial", "z_rate"}]
