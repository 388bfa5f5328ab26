"""Many steps in one compiled loop: the bits, counts and errors of single steps; and it stays prompt."""

import json
import signal
import subprocess
import sys
from itertools import product
from time import monotonic, process_time, sleep

import numpy as np
import pytest
from conftest import ROOT, run_ranks
from ranks import environment
from with_all import with_all

from particles_mpi import Scene, Simulation, StoppedError
from particles_mpi.integrators import many_steps

pytestmark = pytest.mark.parallel

GRAVITY = {"mutual_gravity": {"G": 1.0, "softening": 0.05}}
DOWN = {"uniform_gravity": {"acceleration": [0.3, -1.0]}}
PUSHED = {"user_acceleration": {}}
PLANES = {"walls": {"planes": [{"point": [0, -3], "normal": [0.2, 1]}, {"point": [0, 5], "normal": [0, -1]}]}}
BOX = {"lower": [-3.0, -0.4], "upper": [3.0, 4.0]}
MANY = 4500  # more than a block
FORCES = {
    "none": {},
    "gravity": GRAVITY,
    "down, then gravity": DOWN | GRAVITY,
    "gravity, then pushed and down": GRAVITY | PUSHED | DOWN,
    "pushed": PUSHED,
}
LOSSES = {"": {}, "drag": {"drag": {"rate": 0.2}}, "friction": {"friction": {"strength": 0.3}}}
LOSSES["drag and friction"] = LOSSES["drag"] | LOSSES["friction"]
BODIES = [
    {"position": [[1.0, 0.0], [-1.0, 0.1]], "velocity": {"speed": 0.5}, "mass": 1.0, "drag": 0.7, "acceleration": [0.5, 0.1]},
    {"position": [[0.0, 2.0], [0.3, -2.0]], "velocity": {"speed": 2.5}, "mass": {"min": 0.2, "max": 0.5}, "radius": 0.1},
    {"position": [[3.0, 0.0]], "fixed": True, "mass": 2.0},
]


def tables(effects, integrator, box=None, particles=BODIES):
    """A scene of 40 steps; keys of particles that no effect asks for are left out."""
    unknown = {key for key, effect in (("drag", "drag"), ("acceleration", "user_acceleration")) if effect not in effects}
    particles = [{key: value for key, value in table.items() if key not in unknown} for table in particles]
    time = {"step": 0.05, "steps": 40, "integrator": integrator}
    return {"dimension": 2, "time": time, "particles": particles, "effects": effects} | ({"box": box} if box else {})


def scenes():
    """Every force with every loss, walls and a periodic box, by every integrator that takes them."""
    found = {}
    for (forced, forces), (lossy, losses) in product(FORCES.items(), LOSSES.items()):
        for integrator in ("leapfrog", "taylor", "order4", "adaptive"):
            if (losses and integrator in ("order4", "adaptive")) or ("friction" in losses and integrator == "taylor"):
                continue
            found[f"{integrator}: {forced}; {lossy}"] = tables(forces | losses, integrator)
            if integrator in ("leapfrog", "taylor"):
                found[f"{integrator}: {forced}; {lossy}; walls"] = tables(forces | losses | PLANES, integrator)
    for name, effects in {"lossy walls": {}, **LOSSES}.items():  # most come to rest on the floor
        falling = {"uniform_gravity": {"acceleration": [0.0, -20.0]}, "walls": {"restitution": 0.4}} | effects
        many = [{"count": MANY, "position": "random", "radius": 0.01, "velocity": {"speed": 3.0}}, *BODIES[:1]]
        found[f"lossy walls; {name}"] = tables(falling, "leapfrog", BOX, many)
        found[f"elastic walls; {name}"] = tables(falling | {"walls": {}}, "leapfrog", BOX, many)
    box = {"lower": [-4.0, -4.0], "upper": [4.0, 4.0], "periodic": [True, False]}
    for integrator in ("leapfrog", "adaptive"):
        found[f"{integrator}: periodic"] = tables(PUSHED, integrator, box)
    spheres = [BODIES[0] | {"radius": 0.2, "mass": [1.0, 0.3]}, *BODIES[1:]]
    for (forced, forces), (lossy, losses) in product(FORCES.items(), LOSSES.items()):
        for mode, around in product(("rewind", "event"), ({}, PLANES)):
            name = f"spheres in mode {mode}: {forced}; {lossy}; {'walls' if around else ''}"
            found[name] = tables(forces | losses | around | {"collisions": {"mode": mode}}, "leapfrog", None, spheres)
    for mode, integrator in product(("rewind", "event"), ("leapfrog", "taylor")):  # with losses but without forces none lasts
        more = {"collisions": {"mode": mode, "restitution": 0.7}} | (LOSSES["drag"] if integrator == "taylor" else {})
        small = {"lower": [-2.0, -2.0], "upper": [2.0, 2.0], "periodic": [True, False]}
        dozen = [{"count": 12, "position": "random", "radius": 0.1, "velocity": {"speed": 3.0}}]
        found[f"spheres in mode {mode}: periodic, {integrator}"] = tables(more | {"walls": {}}, integrator, small, dozen)
        two = [{"position": [[-1.7, 0.0], [1.7, 0.4]], "radius": 0.3, "velocity": [[-9.0, 1.0], [9.0, 0.0]]}]
        found[f"spheres in mode {mode}: across a face, {integrator}"] = tables(more, integrator, small | {"periodic": True}, two)
    # Three pairs meet after 5, 9 and 13 steps, the last one across two ranks; in the order of their ids, so that none is sorted.
    row = {"position": [[x, 0.0] for x in (0.0, 2.0, 2.9, 5.9, 7.6, 10.6, 11.9, 14.0)], "velocity": [[-1.0, 0.0], [1.0, 0.0]] * 4}
    for mode in ("rewind", "event"):
        found[f"spheres in mode {mode}: one beside the other"] = tables(
            {"collisions": {"mode": mode}}, "leapfrog", None, [row | {"radius": 0.2}]
        )
    return found


@pytest.mark.parametrize("ranks", [1, 2, *with_all(3)])
def test_same_bits_and_counts_as_single_steps(ranks, tmp_path):
    every = scenes()
    if ranks == 2:  # each force and each loss once; three ranks, with --all, run all of them
        with_drag = [name for name in every if name.startswith("leapfrog") and "drag and friction" in name]
        some = (
            "adaptive",
            "lossy",
            "leapfrog: peri",
            "spheres in mode rewind: g",
            "spheres in mode rewind: one",
            "spheres in mode event: p",
        )
        every = {name: every[name] for name in every if name in with_drag or name.startswith(some)}
    file = tmp_path / "scenes.json"
    file.write_text(json.dumps(every))
    done = run_ranks(ranks, ROOT / "tests" / "parallel" / "many_steps.py", file, timeout=300)
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.splitlines() == [f"{name}: the same" for name in every]


@pytest.mark.parametrize("spheres", [2, many_steps.MOST_SPHERES + 1])
def test_a_step_too_long_for_a_periodic_box_is_told_of_few_spheres_as_of_many(spheres):
    """They fall ever faster along an axis, side by side: nobody meets anybody."""
    box = {"lower": [0.0, 0.0], "upper": [40.0, 40.0], "periodic": True}
    row = [{"position": [[0.0, 2.0 * k] for k in range(spheres)], "radius": 0.5}]
    down = {"uniform_gravity": {"acceleration": [1.0, 0.0]}, "collisions": {}}
    sim = Simulation(Scene.from_dict(tables(down, "leapfrog", box, row) | {"time": {"step": 0.5, "steps": 1000}}))
    assert bool(sim.many_steps) == (spheres == 2)
    too_far = "too far to tell particles from their images in a periodic box of 40"
    with pytest.raises(StoppedError, match=rf"time\.step: a particle crosses 9\.\d+ in one step, {too_far}"):
        sim.run()


@pytest.mark.parametrize("mode", ["rewind", "event"])
def test_a_step_of_few_spheres_goes_alone_only_where_someone_is_met(mode):
    """Two that fly to and fro between walls, and meet in the middle: of 4000 steps some are not like the others."""
    pair = [{"position": [[0.3, 0.5], [1.7, 0.5]], "velocity": [[1.0, 0.0], [-1.0, 0.0]], "radius": 0.1}]
    box = {"lower": [0.0, 0.0], "upper": [2.0, 1.0]}
    effects = {"collisions": {"mode": mode}, "walls": {}}
    sim = Simulation(Scene.from_dict(tables(effects, "leapfrog", box, pair) | {"time": {"step": 0.01, "steps": 4000}}))
    single = []
    sim.advance = lambda *arguments, advance=sim.advance: (single.append(1), advance(*arguments))
    sim.run()
    met = sim.totals["collisions"] + sim.totals["wall_hits"] // 2
    assert met > 40 and met <= len(single) <= 4 * met


def test_another_way_to_sum_ends_it():
    """A force that is changed between steps to one that the compiled loop does not know."""
    sim = Simulation(Scene.from_dict(tables(GRAVITY, "leapfrog")))
    sim.steps(3)
    sim.effects["mutual_gravity"].method = "tree"
    assert sim.many_steps is None
    sim.steps(3)
    sim.effects["mutual_gravity"].method = "direct"
    sim.effects["mutual_gravity"].G = 2.0
    assert sim.many_steps.direct.G == 2.0


@pytest.mark.parametrize("at_once", [1, 1000])
def test_stops_at_the_step_at_which_the_watchdog_looks(at_once):
    """A speed that overflows: at step 10 or 20 and so on, however many steps are asked for at once."""
    time = {"step": 1e3, "steps": 1000, "integrator": "taylor"}
    sim = Simulation(Scene.from_dict(tables({"drag": {"rate": 1e3}}, "taylor") | {"time": time}))
    with pytest.raises(StoppedError, match="step 60: particle 0 on rank 0"):
        while True:
            sim.steps(at_once) if at_once == 1 else sim.step_towards(1000)
            if sim.steps_done % 10 == 0:
                sim.watch()


ROOM = {"lower": [-4.0, -4.0], "upper": [4.0, 4.0]}
ASKED_FOR_HOURS = {
    "one in flight": tables(DOWN, "leapfrog", particles=BODIES[:1]),
    "all at rest on the floor": tables(DOWN | {"walls": {"restitution": 0.4}}, "leapfrog", ROOM),
    "all bounce for ever": tables(DOWN | {"walls": {}}, "leapfrog", ROOM),
    "losses": tables(DOWN | LOSSES["drag and friction"] | {"walls": {"restitution": 0.4}}, "leapfrog", ROOM),
    "taylor": tables(DOWN | LOSSES["drag"] | {"walls": {}}, "taylor", ROOM),
    "adaptive": tables(GRAVITY, "adaptive"),
    "attraction, and walls": tables(DOWN | GRAVITY | {"walls": {}}, "leapfrog", ROOM),
}


@pytest.mark.parametrize("name", ASKED_FOR_HOURS)
def test_one_call_takes_a_moment_whatever_bodies_do(name):
    """A signal is heard between two calls of the compiled loop; 0.1 s is meant, 200 times as much was seen of those at rest."""
    sim = Simulation(Scene.from_dict(ASKED_FOR_HOURS[name]))
    sim.steps(1000)  # by then they rest, where anything takes their energy
    begun = process_time()
    sim.step_towards(10**9)
    assert sim.many_steps and 1000 < sim.steps_done < 10**9 and process_time() - begun < 0.5


def test_many_blocks_take_fewer_steps_at_once(monkeypatch):
    """Where rows are advanced in blocks, all of them take the same number of steps, which is as many as there is time for."""
    sim = Simulation(Scene.from_dict(scenes()["elastic walls; "]))
    monkeypatch.setattr(many_steps, "LONGEST_CALL", 3.5 * many_steps.ROW_NS * sim.total)
    sim.step_towards(40)
    assert len(sim.many_steps.blocks) > 1 and sim.steps_done == 3


def test_ctrl_c_is_heard_at_once(tmp_path):
    """Of a run that would take hours, and that a resumed one continues with the same bits as one that was not stopped."""
    scene = tmp_path / "orbit.toml"
    text = (ROOT / "particles_mpi" / "scenes" / "figure_eight.toml").read_text()
    scene.write_text(text.replace("steps = 4000", "steps = 100_000_000_000").replace("every = 100", "every = 1_000_000_000"))
    scene.write_text(scene.read_text() + "diagnostics_every = 1_000_000_000\ncheckpoint_every = 1_000_000_000\n")
    command = [sys.executable, "-m", "particles_mpi", "run", str(scene), "--output", str(tmp_path / "out")]
    run = subprocess.Popen(command, cwd=ROOT, env=environment(), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    end = monotonic() + 60
    while not (tmp_path / "out" / "trajectory.vtkhdf").exists() and monotonic() < end:
        sleep(0.05)
    sleep(1.0)
    run.send_signal(signal.SIGTERM)
    asked = monotonic()
    _, said = run.communicate(timeout=60)
    assert run.returncode == 130 and "stopped at step" in said, said
    assert monotonic() - asked < 5.0  # a loaded machine; 0.2 s were seen
    sim = Simulation.resume(tmp_path / "out" / "checkpoint.h5")
    steps = sim.steps_done
    assert steps > 10_000
    other = Simulation(Scene.load(ROOT / "particles_mpi" / "scenes" / "figure_eight.toml"))
    other.steps(steps)
    np.testing.assert_array_equal(sim.particles.position, other.particles.position)
