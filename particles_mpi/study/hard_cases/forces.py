"""Friction and drag where explicit rules fail."""

import numpy as np

from particles_mpi.study.experiment import everyone
from particles_mpi.study.hard_cases.catalogue import CaseRun, Effects, Finding, case


@case(
    "friction at rest, force below alpha", "0/0 makes NaN, or the particle creeps", "v and displacement exactly 0", modes=(None,)
)
def friction_at_rest(run: CaseRun) -> Finding:
    """Eight particles at rest, pushed harder one by one."""
    places = [run.point(float(k)) for k in range(8)]
    pushes = [run.point(0.999 * k / 7.0) for k in range(8)]
    effects = {"friction": {"strength": 1.0}, "user_acceleration": {}}
    sim = run.simulate([{"position": places, "acceleration": pushes}], 0.1, 1000, effects)
    sim.run()
    p = everyone(sim)
    moved, fast = np.abs(p.position - places).max(), np.abs(p.velocity).max()
    return f"v {fast:.0f}, displacement {moved:.0f}", bool(moved == 0.0 and fast == 0.0)


@case("drag with k dt = 10", "explodes, or changes sign every step", "monotone decay to g/k", modes=(None,))
def stiff_drag(run: CaseRun) -> Finding:
    """Two particles thrown up and down, each a hundred times as fast as it falls in the end."""
    thrown = {"position": [run.point(), run.point(1.0, rest=1.0)], "velocity": [run.upright(v) for v in (100.0, -100.0)]}
    effects: Effects = {"drag": {"rate": 100.0}, "uniform_gravity": {"acceleration": run.upright(-9.81)}}
    sim = run.simulate([thrown], 0.1, 40, effects)
    end, before, monotone = -9.81 / 100.0, np.inf, True
    for _ in range(40):
        sim.step()
        left = np.abs(everyone(sim).velocity[:, -1] - end).max()
        monotone &= bool(left <= before)
        before = left
    return f"{'monotone' if monotone else 'NOT monotone'}, {before / abs(end):.0e} off g/k", monotone and before <= 1e-12
