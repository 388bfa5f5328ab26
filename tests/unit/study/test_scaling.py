"""`study scaling`: the scenes of weak scaling, what efficiency is, and that the model finds the costs it was made from."""

from dataclasses import replace
from math import log2

import numpy as np
import pytest

from particles_mpi import Scene, SceneError
from particles_mpi.initial.populate import populate
from particles_mpi.study.scaling.counted import verdict
from particles_mpi.study.scaling.measure import HEADLINE, rank_counts, settings
from particles_mpi.study.scaling.performance_model import NETWORK_BANDWIDTH, NETWORK_LATENCY, Law, Model, Point, fit
from particles_mpi.study.scaling.report import Curve, Result, what_ends
from particles_mpi.study.scaling.scale_scene import edges, scale_scene, unable_to_grow

CUBE = Law("N", (1.0, 1.0, 1.0), (False, False, False))


def gas(**population):
    table = {"count": 300, "position": "random", "velocity": {"speed": 1.0}, "radius": 0.02, "mass": 1.0} | population
    floor = {"planes": [{"point": [2.0, 1.0, 1.0], "normal": [0.0, 0.0, 1.0]}]}
    return Scene(
        dimension=3,
        seed=3,
        box={"lower": [1.0, 1.0, 1.0], "upper": [3.0, 2.0, 2.5]},
        time={"step": 0.01, "steps": 10},
        particles=[table],
        effects={"collisions": {}, "walls": floor},
    )


@pytest.mark.parametrize("position", ["random", "lattice"])
def test_a_grown_gas_has_the_same_density_and_radii(position):
    scene = gas(position=position)
    large = scale_scene(scene, 4)
    (small_rows, _), (rows, warnings) = populate(scene), populate(large)
    assert len(rows) == 4 * len(small_rows) and not warnings and (rows.radius == 0.02).all()
    sides, before = (np.subtract(s.box.upper, s.box.lower) for s in (large, scene))
    assert np.isclose(np.prod(sides), 4 * np.prod(before)) and np.allclose(sides / before, 4 ** (1 / 3))
    assert large.box.lower == scene.box.lower and edges(large) == pytest.approx(edges(scene))
    assert large.effects["walls"].planes[0].point == pytest.approx([1.0 + 4 ** (1 / 3), 1.0, 1.0])  # half-way, as before
    assert scale_scene(scene, 1) == scene


def test_a_grown_cluster_keeps_density_and_mass_of_a_star():
    tables = {
        "dimension": 3,
        "G": 1.0,
        "time": {"step": 0.01, "steps": 1},
        "particles": [{"count": 100, "position": {"plummer": 2.0}, "velocity": "equilibrium", "mass": 0.01}],
        "effects": {"mutual_gravity": {}},
    }
    large = scale_scene(Scene.from_dict(tables), 8)
    assert large.particles[0].count == 800 and large.particles[0].mass == 0.01
    assert large.particles[0].position == {"plummer": pytest.approx(4.0)}


@pytest.mark.parametrize(
    "population, key",
    [
        ({"count": None, "position": [[1.5, 1.5, 1.7], [2.5, 1.5, 1.7]]}, "position"),
        ({"count": None, "position": {"file": "start.csv"}}, "position"),
        ({"velocity": [[0.0, 0.0, 1.0]] * 300}, "velocity"),
        ({"radius": [0.02] * 300}, "radius"),
        ({"fixed": [True] * 300}, "fixed"),
    ],
)
def test_what_is_listed_has_no_weak_scaling(population, key):
    scene = gas(**population)
    with pytest.raises(SceneError, match=rf"particles\[0\]\.{key}: "):
        scale_scene(scene, 2)
    assert len(unable_to_grow(scene)) == 1
    assert settings(scene, [1, 2], [1.0], False) == [(1.0, 1), (1.0, 2)]


def test_which_settings_are_measured():
    assert rank_counts(1) == [1] and rank_counts(6) == [1, 2, 4, 6] and rank_counts(8) == [1, 2, 4, 8]
    assert not unable_to_grow(gas(velocity=[0.0, 0.0, 1.0]))  # one vector for all
    turning = {"count": 10, "position": "random", "radius": 0.1, "spin": [0.0, 0.0, 1.0]}
    rough = Scene.from_dict(gas().to_dict() | {"particles": [turning], "effects": {"collisions": {"friction": 0.3}}})
    assert not unable_to_grow(rough) and scale_scene(rough, 2).particles[0].spin == [0.0, 0.0, 1.0]
    assert settings(gas(), [1, 2], [1.0], True) == [(1.0, 1), (1.0, 2), (2.0, 2)]
    assert settings(Scene.load(HEADLINE), [1, 2], [1.0, 8.0], True)[-2:] == [(2.0, 2), (1 / 8, 1)]


def test_blocks_and_their_neighbours():
    assert [CUBE.cuts(p) for p in (1, 2, 4, 8)] == [[1, 1, 1], [2, 1, 1], [2, 2, 1], [2, 2, 2]]
    assert [CUBE.neighbours(p) for p in (1, 2, 4, 8)] == [0, 1, 3, 7]
    assert 25 < CUBE.neighbours(1 << 21) <= 26
    assert np.prod(CUBE.cuts(6)) == pytest.approx(6)
    assert Law("N", (4.0, 0.5, 0.5), (False,) * 3).cuts(4) == [4, 1, 1]  # a channel is cut across
    round_ = Law("N", (1.0, 1.0, 1.0), (True,) * 3)
    assert round_.sides(2) == [2, 0, 0] and round_.neighbours(2) == 1


def test_ghost_rows_are_those_of_a_layer():
    n, t = 32_000, 0.7
    assert CUBE.rows(n, 2, t) == pytest.approx(n ** (2 / 3) * t)  # one face of the cube
    edge = n ** (1 / 3) / 4
    assert CUBE.rows(n, 64, t) == pytest.approx((edge + 1.5 * t) ** 3 - edge**3)  # of four blocks the outer two have one side
    assert CUBE.rows(n, 2, 1e9) == pytest.approx(n / 2)  # all others, at most
    for ranks in (2, 3, 8, 64):
        assert CUBE.thickness(n, ranks, CUBE.rows(n, ranks, t)) == pytest.approx(t)
    direct = replace(CUBE, fetches_all=True)
    assert direct.rows(1000, 4, 1.0) == 750 and direct.thickness(1000, 4, 1500.0) == 2


def measured(model, particles, ranks, factor=1.0):
    """The point that the model would give on a machine `factor` times as slow."""
    parts = model.parts(particles, ranks)
    talk = parts["latency"] + 0.75 * parts["rows"]
    own = parts["fixed"] + parts["work"] / (model.imbalance if ranks > 1 else 1.0) + 0.25 * parts["rows"]
    slowest = own * (model.imbalance if ranks > 1 else 1.0)
    counts = {name: getattr(model, name) for name in ("fetches", "reductions", "all_to_alls")}
    counts |= {"messages": model.messages * model.law.neighbours(ranks), "rows": model.rows(particles, ranks)}
    counts |= {"bytes_counts": 0.25 * model.for_each * (ranks - 1), "bytes_gathers": 0.75 * model.for_each * (ranks - 1)}
    if ranks == 1:
        counts = dict.fromkeys(counts, 0.0)
    seconds = factor * sum(parts.values())
    return Point(particles, ranks, seconds, seconds, seconds, factor * own, factor * slowest, factor * talk, counts)


def synthetic(law=CUBE):
    return Model(law, 0.8, 0.15, 3.0, 5.0, 0.25, 80.0, 4, 1.0, 1e-4, 7e-8, 3e-7, 8e-6, 40.0)


@pytest.mark.parametrize("growth", ["N", "N log N", "N^2"])
def test_the_model_finds_the_costs_it_was_made_from(growth):
    made = synthetic(replace(CUBE, growth=growth))
    pairs = [(4000, 1), (32_000, 1), (32_000, 2), (64_000, 2), (32_000, 4), (128_000, 4)]
    points = [measured(made, *pair) for pair in pairs]
    found = fit(points, made.law, made.row_bytes)
    for name in ("fixed", "each", "row", "latency", "imbalance"):
        assert getattr(found, name) == pytest.approx(getattr(made, name), rel=1e-6), name
    for name in ("thickness", "fetches", "messages", "reductions", "all_to_alls", "for_each"):
        assert getattr(found, name) == pytest.approx(getattr(made, name), rel=1e-6), name
    assert max(abs(found.residual(p)) for p in points) < 1e-6
    assert found.seconds(1e6, 512) == pytest.approx(made.seconds(1e6, 512), rel=1e-6)


def test_work_that_is_not_shared_does_not_shrink():
    made = synthetic(replace(CUBE, fetches_all=True, shared=False))
    assert made.parts(1000, 64)["work"] == made.parts(1000, 1)["work"]
    found = fit([measured(made, *pair) for pair in [(500, 1), (1000, 1), (1000, 2), (2000, 2)]], made.law, 80.0)
    assert found.each == pytest.approx(made.each) and found.row == pytest.approx(made.row)
    assert "on every rank" in found.assumptions[0] and "evenly" in synthetic().assumptions[0]


def test_ranks_that_share_cores_are_counted_and_not_timed():
    made = synthetic()
    points = [measured(made, *pair) for pair in [(4000, 1), (32_000, 1), (32_000, 2), (64_000, 2)]]
    crowded = replace(measured(made, 32_000, 4, factor=20.0), oversubscribed=True)
    found = fit([*points, crowded], made.law, made.row_bytes)
    assert found.each == pytest.approx(made.each) and found.latency == pytest.approx(made.latency)
    assert found.measured == 2
    lonely = fit([*points[:2], crowded], made.law, made.row_bytes)  # no core for a second rank: counts alone
    assert lonely.latency == 0.0 and lonely.reductions == 5.0
    assert lonely.parts(32_000, 64)["latency"] == pytest.approx(NETWORK_LATENCY * lonely.stages(64))


def test_what_the_model_must_say_in_the_limits():
    made = synthetic()
    assert made.parts(32_000, 1)["rows"] == made.parts(32_000, 1)["latency"] == 0.0
    t = [made.seconds(32_000, p) for p in (1, 2, 4, 8)]
    assert t == sorted(t, reverse=True) and made.seconds(32_000, 1024) > made.seconds(32_000, 64)  # latency wins in the end
    assert made.efficiency(32_000, 1, 32_000) == 1.0
    assert made.efficiency(64 * 32_000, 64, 32_000) > made.efficiency(32_000, 64, 32_000)
    assert any("memory" in line for line in made.assumptions) and "(more than 4 ranks)" in " ".join(made.assumptions)


def test_efficiency_is_what_the_course_calls_so():
    def point(particles, ranks, seconds):
        return Point(particles, ranks, seconds, seconds, seconds, seconds, seconds, 0.0, {})

    one = point(1000, 1, 8.0)
    strong, weak = Curve(False, [one, point(1000, 4, 2.5)]), Curve(True, [one, point(4000, 4, 10.0)])
    result = Result("", CUBE, [strong, weak], [], None, [], False)
    assert result.efficiency(strong, one) == 1.0
    assert result.efficiency(strong, strong.points[1]) == pytest.approx(8.0 / (4 * 2.5))  # T1 / (P TP)
    assert result.efficiency(weak, weak.points[1]) == pytest.approx(8.0 / 10.0)  # T1 / TP
    assert strong.particles(4) == 1000 and weak.particles(4) == 4000
    tree = replace(result, law=replace(CUBE, growth="N log N"))
    assert tree.efficiency(weak, weak.points[1]) == pytest.approx(0.8 * log2(4000) / log2(1000))


def test_what_ends_the_scaling():
    made, quick = synthetic(), replace(synthetic(), latency=0.0)
    weak, strong = (Curve(kind, [measured(made, 32_000, 1)]) for kind in (True, False))
    assert what_ends(made, strong).startswith("on 1024 ranks latency of messages to neighbours, ")
    assert what_ends(made, weak).endswith(
        "growth between the two: bytes for all other ranks, by 0.26 ms"
    )  # 40 to each of 64 512 more
    assert what_ends(replace(made, for_each=0.0), weak).endswith(
        "growth between the two: latency of reductions, by 0.24 ms"
    )  # 5 in 6 stages
    assert "on 65536 ranks latency of reductions, " in what_ends(replace(made, reductions=500.0), weak)
    assert "on 65536 ranks latency of exchanges of all with all, " in what_ends(replace(made, all_to_alls=500.0), weak)
    assert "on 1024 ranks fixed costs of a step, 100% of" in what_ends(replace(quick, fixed=1.0), strong)
    assert "fixed costs" not in what_ends(replace(quick, fixed=1.0), weak)
    parts = made.parts(32_000, 4)
    assert parts["all_others"] == 0.0  # within a machine
    assert made.parts(32_000, 65_536)["all_others"] == pytest.approx(65_535 * 40.0 / NETWORK_BANDWIDTH)


def counted(ranks, particles, **columns):
    """A point with these columns; ghosts: those of a layer of one mean distance."""
    known = {"ghosts": CUBE.rows(particles, ranks, 1.0), "bytes_rows": 0.0, "bytes_counts": 0.0} | columns
    known |= {"bytes_gathers": known.get("bytes_gathers", 0.0), "bytes_reductions": 0.0}
    return Point(particles, ranks, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, known, most=known)


@pytest.mark.parametrize("weak", [True, False])
def test_columns_are_flat_or_as_surfaces_or_named(weak):
    sizes = [(ranks, 2000 * (ranks if weak else 32)) for ranks in (8, 16, 32)]

    def said(name, law):
        return verdict(name, [counted(*size, **{name: law(*size)}) for size in sizes], CUBE)

    assert said("reductions", lambda ranks, n: 4.0 + ranks / 320) == "flat"
    assert said("reductions", lambda ranks, n: float(ranks)).startswith(
        "NOT FLAT, from 8 to 32 on 32 ranks, as P^1.00: ranks agree"
    )
    assert said("bytes_counts", lambda ranks, n: 0.0) == "flat"
    assert said("messages", lambda ranks, n: 3.0 * CUBE.neighbours(ranks)).endswith("like the number of neighbours of a block")
    assert said("messages", lambda ranks, n: ranks - 1.0).startswith("NOT FLAT")
    surface = said("ghosts", lambda ranks, n: CUBE.rows(n, ranks, 1.0))
    assert surface.endswith("like the surfaces that a block has in common with others") and "NOT FLAT" not in surface
    assert said("ghosts", lambda ranks, n: n - n / ranks).startswith("NOT FLAT")  # all others
    held = said("memory", lambda ranks, n: 1e-3 * (n / ranks + CUBE.rows(n, ranks, 1.0)))
    assert "NOT FLAT" not in held
    everything = said("memory", lambda ranks, n: 1e-3 * n)
    assert everything.startswith("NOT FLAT") and everything.endswith("or all particles")
    if not weak:  # it should fall
        assert said("ghosts", lambda ranks, n: 1000.0).startswith("NOT FLAT")
    growing = [counted(*size, bytes=10.0 * size[0], bytes_gathers=9.0 * size[0], bytes_counts=float(size[0])) for size in sizes]
    assert verdict("bytes", growing, CUBE).endswith("each rank sends its box, or an error, to all others: P - 1 times")
