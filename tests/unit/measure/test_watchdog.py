"""The watchdog names who is lost, astray or not a number, and on which step and rank; in a run it keeps the rows."""

import h5py
import numpy as np
import pytest

from particles_mpi import Scene, Simulation, StoppedError


def gas(**changes):
    scene = dict(
        dimension=2,
        seed=1,
        box={"lower": [0, 0], "upper": [10, 10]},
        time={"step": 0.01, "steps": 30},
        particles=[{"count": 20, "position": "random", "radius": 0.2, "velocity": {"speed": 1.0}}],
        effects={"walls": {}},
        output={"every": 10, "formats": ["hdf5"]},
    )
    return Simulation(Scene(**(scene | changes)))


def lose(p):
    p.replace({name: array[p.id != 7] for name, array in p.arrays.items()})


def double(p):
    p.id[p.id == 7] = 8


def nan(p):
    p.velocity[3] = np.nan


def outside(p):
    p.position[5] = [3.0, -0.1]


FAULTS = [
    (lose, "lost: particle 7"),
    (double, "lost: particle 7; present more than once: 8 on ranks 0"),
    (nan, "particle 3 on rank 0 has a position or velocity that is not finite"),
    (outside, r"particle 5 on rank 0 is beyond wall \d, at \(3, -0.1\)"),
]


@pytest.mark.parametrize(("harm", "says"), FAULTS)
def test_what_is_wrong_is_named(harm, says):
    sim = gas()
    sim.watch()
    harm(sim.rows)
    with pytest.raises(StoppedError, match=f"step 0: {says}"):
        sim.watch()


def test_outside_a_periodic_box():
    sim = gas(box={"lower": [0, 0], "upper": [10, 10], "periodic": True}, effects={})
    sim.particles.position[4, 0] = 10.5
    with pytest.raises(StoppedError, match=r"particle 4 on rank 0 is outside the periodic box, at \(10.5, "):
        sim.watch()


def test_open_space_has_no_outside():
    sim = gas(box=None, particles=[{"position": [[1e9, -1e9]], "velocity": [1e5, 0.0]}], effects={})
    sim.run()
    sim.watch()


def test_a_run_keeps_the_rows_and_the_last_checkpoint(tmp_path):
    """Stops within ten steps, whatever else it was to do, with exit code 3; what was written before is whole."""
    sim = gas(output={"every": 10, "formats": ["hdf5"], "checkpoint_every": 10})
    step, harmed = sim.step, []

    def faulty():
        step()
        if sim.steps_done == 15:
            harmed.append(sim.rows.id[0])
            sim.rows.position[0] = [50.0, 50.0]  # not by a user, who would be told at once

    sim.step = faulty
    with pytest.raises(StoppedError, match=r"step 20: particle .* is beyond wall .* all particles are in .*stopped.h5") as raised:
        sim.run(tmp_path / "out")
    assert raised.value.exit_code == 3
    with h5py.File(tmp_path / "out" / "stopped.h5") as file:
        assert "beyond wall" in file.attrs["error"] and file.attrs["step"] == 20
        row = list(file["particles/id"]).index(harmed[0])
        assert file["particles/position"][row].min() > 40.0 and file["particles/rank"][row] == 0
    with h5py.File(tmp_path / "out" / "trajectory.vtkhdf") as file:
        assert list(file["VTKHDF/Steps/Step"]) == [0, 10]
    assert Simulation.resume(tmp_path / "out" / "checkpoint.h5").steps_done == 10
