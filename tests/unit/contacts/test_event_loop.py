"""The event loop ends whatever state it is given, with ids and time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from particles_mpi import Scene, Simulation
from particles_mpi.errors import StateError, StoppedError
from particles_mpi.neighbours import verlet_lists
from particles_mpi.neighbours.verlet_kernels import SKIN


def discs(mode="event", **population):
    particles = [{"position": [[0, 0], [1.5, 0], [3.2, 0.1]], "radius": 0.5} | population]
    time = {"step": 0.5, "steps": 4}
    sim = Simulation(Scene(dimension=2, time=time, particles=particles, effects={"collisions": {"mode": mode}}))
    sim.many_steps = None  # each step for itself, as of more spheres
    return sim


def test_fixed_spheres_that_are_given_a_velocity_stay():
    sim = discs(fixed=[True, True, False])
    sim.particles.velocity[0] = [5.0, 0.0]
    sim.step()
    assert (sim.particles.velocity == 0.0).all() and (sim.particles.position[0] == 0.0).all()


def test_particles_made_fixed_while_others_move_are_hit():
    sim = discs(velocity=[[0, 0], [2.0, 0.0], [0.0, 0.0]])
    sim.step()
    sim.particles.fixed[:2] = True
    x = sim.particles.position[:2].copy()
    sim.particles.velocity[2] = [-4.0, 0.0]
    sim.run()
    assert (sim.particles.position[:2] == x).all() and sim.particles.velocity[2, 0] > 0.0


def test_time_that_stands_still_is_told_with_ids_and_time():
    """A particle with no room before it leaves its neighbourhood would leave it for ever."""
    sim = discs(velocity=[[0, 0], [1.0, 0.0], [0.0, 0.0]])
    sim.step()
    engine = sim.near.whole.engine
    engine.lists.arrays.reference[:, 2 + SKIN] = 0.0
    with pytest.raises(StateError, match=r"step 2: time does not advance at t = [0-9.]+: .* particle 1 leaves its neighbourhood"):
        sim.step()
    assert StateError.exit_code == 3


@pytest.mark.parametrize("size", [1.0, 1e30])
def test_a_way_that_would_take_years_is_refused_by_name(size, monkeypatch):
    """Time passes, in steps of hardly more than round-off of the position; not for a few rows, which are all in one list."""

    def far_too_fast():
        sim = discs(velocity=[[1.0, 0.0], [-1.0, 0.2], [0.5, -0.5]])
        sim.step()
        sim.particles.position[2], sim.particles.radius[2], sim.particles.velocity[2] = size, 0.1 * size, 1e12 * size
        return sim

    far_too_fast().step()
    monkeypatch.setattr(verlet_lists, "FEW_ROWS", 0)
    monkeypatch.setitem(verlet_lists.WANTED, 2, 1.0)
    sim = far_too_fast()
    with pytest.raises(StateError, match=r"t = 0.5: particle 2 crosses 7.07e\+\d\d in a step, .* shorten time.step"):
        sim.step()


ODD = [0.0, -1.0, 1e-300, 1e-30, 1e-9, 0.5, 1.0, 3.0, 1e9, -1e9, 1e30, 1e150, np.inf, -np.inf, np.nan]


def any_scene(draw):
    """Four spheres in one to three dimensions, in any box, with any effects that collisions go with."""
    d = draw(st.integers(1, 3))
    rough = d > 1 and draw(st.booleans())
    surface = draw(st.sampled_from([{}, {"restitution": 0.5}, {"restitution": 0.0}])) | ({"friction": 0.3} if rough else {})
    effects = {"collisions": {"mode": draw(st.sampled_from(["event", "rewind"]))} | surface}
    more = {
        "uniform_gravity": {"acceleration": [0.0] * (d - 1) + [-9.0]},
        "drag": {"rate": 0.5},
        "friction": {"strength": 0.5},
        "mutual_gravity": {"G": 1.0, "softening": 0.1, "method": draw(st.sampled_from(["direct", "tree"]))},
    }
    box = draw(st.sampled_from(["none", "walls", "periodic"]))
    names = draw(st.sets(st.sampled_from([*more]), max_size=2)) - ({"mutual_gravity"} if box == "periodic" else set())
    effects |= {name: more[name] for name in sorted(names)} | ({"walls": surface} if box == "walls" else {})
    places = [[0.0] * d, [1.5] + [0.0] * (d - 1), [3.2] + [0.1] * (d - 1), [-2.0] + [0.2] * (d - 1)]
    spheres = {"position": places, "radius": 0.5, "velocity": {"speed": 1.0}}
    sides = {"box": {"lower": [-5.0] * d, "upper": [5.0] * d, "periodic": box == "periodic"}} if box != "none" else {}
    time = {"step": draw(st.sampled_from([0.05, 0.2, 0.5])), "steps": 4}
    return Scene(dimension=d, time=time, particles=[spheres], effects=effects, **sides)


@pytest.mark.timeout(100)
@settings(max_examples=100)
@given(st.data())
def test_any_state_ends(data):
    """Fields set to anything between two steps: the next steps end with numbers, or say in one line why not."""
    sim = Simulation(any_scene(data.draw))
    sim.step()
    try:
        for name in ("position", "velocity", "radius", "mass", "fixed", "drag", "spin"):
            for row in data.draw(st.lists(st.integers(0, 3), max_size=2)) if name in sim.particles.arrays else ():
                value = data.draw(st.sampled_from(ODD))
                sim.particles[name][row] = bool(value > 0.7) if name == "fixed" else value
        for _ in range(3):
            sim.step()
        fields = {name: column for name, column in sim.particles.arrays.items() if name != "contacted"}
        assert [name for name, column in fields.items() if not np.isfinite(column).all()] == []
    except StoppedError as error:
        assert len(str(error).splitlines()) == 1 and ("step" in str(error) or str(error).startswith("particles."))


@pytest.mark.parametrize("mode", ["event", "rewind"])
@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("p.radius[0] = 1e30", "particles.radius: a periodic box must be more than twice as wide"),
        ("p.radius[:2] = 2.4", "particles.radius: a periodic box must be more than twice as wide"),
        ("p.position[1] = 1e30", "particles.position: particle 1 on rank 0 was given 1e.30, 1e.30, which"),
        ("p.velocity[1, 0] = 1e9", "particles.velocity: particle 1 on rank 0 was given 1e.09, 0, which"),
        ("p.spin[2] = np.nan", "particles.spin: particle 2 on rank 0 was given nan, which"),
    ],
)
def test_what_no_box_can_hold_is_refused(change, says, mode):
    """Arrays were read beyond their ends, since no cell is where such a sphere is."""
    box = {"lower": [-4.5, -4.5], "upper": [4.5, 4.5], "periodic": True}
    spheres = {"position": [[0, 0], [1.5, 0], [3.2, 0.1]], "radius": 0.5}
    effects = {"collisions": {"mode": mode, "friction": 0.1}}
    sim = Simulation(Scene(dimension=2, box=box, time={"step": 0.1, "steps": 4}, particles=[spheres], effects=effects))
    sim.step()
    exec(change, {"p": sim.particles, "np": np})
    with pytest.raises(StoppedError, match=says):
        sim.step()
