"""Friction and drag where explicit rules fail."""

import numpy as np

from particles_mpi.study.hard_cases import Bench, case, everyone


@case(
    "friction at rest, force below alpha",
    "0/0 makes NaN, or the particle creeps",
    "v and displacement exactly 0",
    modes=(None,),
)
def friction_at_rest(bench: Bench) -> tuple[str, bool]:
    d = bench.dimension
    places = [[float(k)] + [0.0] * (d - 1) for k in range(8)]
    pushes = [[0.999 * k / 7.0] + [0.0] * (d - 1) for k in range(8)]
    sim = bench.simulate(
        time={"step": 0.1, "steps": 1000},
        particles=[{"position": places, "acceleration": pushes}],
        effects={"friction": {"strength": 1.0}, "user_acceleration": {}},
    )
    sim.run()
    p = everyone(sim)
    moved, fast = np.abs(p.position - places).max(), np.abs(p.velocity).max()
    return f"v {fast:.0f}, displacement {moved:.0f}", bool(moved == 0.0 and fast == 0.0)


@case("drag with k dt = 10", "explodes, or changes sign every step", "monotone decay to g/k", modes=(None,))
def stiff_drag(bench: Bench) -> tuple[str, bool]:
    d = bench.dimension
    sim = bench.simulate(
        time={"step": 0.1, "steps": 40},
        particles=[{"position": [[0.0] * d, [1.0] * d], "velocity": [[0.0] * (d - 1) + [v] for v in (100.0, -100.0)]}],
        effects={"drag": {"rate": 100.0}, "uniform_gravity": {"acceleration": [0.0] * (d - 1) + [-9.81]}},
    )
    end, before, monotone = -9.81 / 100.0, np.inf, True
    for _ in range(40):
        sim.step()
        left = np.abs(everyone(sim).velocity[:, -1] - end).max()
        monotone &= bool(left <= before)
        before = left
    return f"{'monotone' if monotone else 'NOT monotone'}, {before / abs(end):.0e} off g/k", monotone and before <= 1e-12
