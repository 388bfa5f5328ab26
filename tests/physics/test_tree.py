"""The tree against the direct sum, and what it is built from."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from with_all import with_all

from particles_mpi import Scene, SceneError, Simulation
from particles_mpi.gravity.direct import Attraction, attract_few
from particles_mpi.gravity.expansion import CELL_LANES, CELLS, COEFFICIENTS, FAR_WIDTH, add_lanes, enter_cell, evaluate, expand
from particles_mpi.gravity.method import choose
from particles_mpi.gravity.octree import CENTER, GROUP, MASS, RADIUS, divide, levels, moments, morton, skips
from particles_mpi.gravity.powers import inverse_root, pull
from particles_mpi.gravity.tree import Tree
from particles_mpi.gravity.walk import SINGLE
from particles_mpi.initial.plummer import plummer_places
from particles_mpi.parallel.communicator import Communicator


def by_tree(x, mass, angle, softening=0.0, quadrupoles=True):
    tree = Tree(Communicator.alone(), x.shape[1], angle, softening**2, quadrupoles)
    return np.column_stack(tree.attract(np.arange(len(x)), x, mass, np.ones(len(x))))  # (n, 5): acceleration, potential, work


def by_pairs(x, mass, softening=0.0, of=slice(None)):
    return sum_over_pairs(x[of], x, mass, softening)


def sum_over_pairs(at, x, mass, softening=0.0):
    """Accelerations of places `at` by masses at x."""
    sums = Attraction(at, len(x), softening**2)
    sums.add(x, mass)
    return sums.accelerations()


def errors(a, b):
    """Relative errors of vectors a, row by row."""
    return np.sqrt(((a - b) ** 2).sum(axis=1) / (b**2).sum(axis=1))


@pytest.fixture(scope="module")
def sphere():
    """A Plummer sphere of 20 000: places, mass of each, exact accelerations of every tenth."""
    n = 20_000
    mass = np.full(n, 1.0 / n)
    x = plummer_places(np.random.default_rng(1), 1.0, mass)
    return x, mass, by_pairs(x, mass, of=slice(None, None, 10))


@pytest.mark.parametrize(
    ("angle", "median", "most", "worst"),
    [(0.3, 1e-4, 8e-4, 3e-3), (0.5, 5e-4, 4e-3, 1e-2), (0.7, 1.6e-3, 1e-2, 7e-2), (1.0, 7.5e-3, 7e-2, 0.42)],
)
def test_accuracy_on_a_plummer_sphere(sphere, angle, median, most, worst):
    """Medians: physics.md's for quadrupoles and cells of the same angle, by particle; 99th percentiles and the worst: what is
    seen, doubled; at angle 1 physics.md's worst, of a particle whose own cell may be far."""
    x, mass, exact = sphere
    error = errors(by_tree(x, mass, angle)[::10, :3], exact)
    assert np.median(error) <= median
    assert np.quantile(error, 0.99) <= most
    assert error.max() <= worst


@pytest.mark.parametrize(("angle", "median"), [(0.3, 3.1e-4), (0.5, 1.3e-3), (0.7, 3.5e-3), (1.0, 1.1e-2)])
def test_accuracy_of_monopoles(sphere, angle, median):
    """Medians: at most physics.md's for monopoles, at least a third of them, since angles are those of whole groups here.

    Quadrupoles are closer at the same angle.
    """
    x, mass, exact = sphere
    mono, quad = (np.median(errors(by_tree(x, mass, angle, quadrupoles=q)[::10, :3], exact)) for q in (False, True))
    assert median / 3.0 <= mono <= median
    assert quad < 0.8 * mono


def test_a_monopole_acts_as_a_particle_in_the_centre_of_mass():
    """Seen from afar a ball is one cell: with the symmetry of the cube and so without quadrupole it acts as from its middle."""
    corners = np.array([[i, j, k] for i in (-1.0, 1.0) for j in (-1.0, 1.0) for k in (-1.0, 1.0)])
    x = np.concatenate([3.0 + size * corners for size in np.linspace(0.1, 1.0, 32)] + [[[60.0, 30.0, -20.0]]])
    mass = np.append(np.full(256, 1.0 / 64.0), 0.0)
    for softening in (0.0, 3.0):
        mono, quad = (by_tree(x, mass, 0.9, softening, q)[-1] for q in (False, True))
        r = 3.0 - x[-1]
        rho = np.sqrt(r @ r + softening**2)
        np.testing.assert_allclose(mono[:4], [*(4.0 * r / rho**3), -4.0 / rho], rtol=1e-14)
        if softening == 0.0:  # a softened sphere is not a point
            np.testing.assert_allclose(mono[:4], quad[:4], rtol=1e-13)


def test_monopoles_keep_the_momentum_as_well_as_they_are_accurate(sphere):
    """Forces of cells have no reaction: the sum over all is below the median error, that of all cells opened is round-off."""
    x, mass, _ = sphere
    x, mass = x[:2000], mass[:2000]
    for angle, bound in ((0.7, 3e-3), (1e-3, 1e-14)):
        force = mass[:, None] * by_tree(x, mass, angle, quadrupoles=False)[:, :3]
        assert np.abs(force.sum(axis=0)).max() <= bound * np.abs(force).sum()


@pytest.mark.parametrize("quadrupoles", [True, False])
def test_interactions_are_counted(quadrupoles):
    """All pairs where every cell is open; two cells of which one is far: its own and that cell, for each particle."""
    x = np.random.default_rng(4).random((600, 3))
    tree = Tree(Communicator.alone(), 3, 1e-3, 0.0, quadrupoles)
    tree.attract(np.arange(600), x, np.ones(600), np.ones(600))
    assert tree.interactions == 600**2
    x = np.concatenate((x[:150], x[150:250] + 1000.0))  # more than one group
    tree = Tree(Communicator.alone(), 3, 0.5, 0.0, quadrupoles)
    tree.attract(np.arange(250), x, np.ones(250), np.ones(250))
    assert tree.interactions == 150 * (150 + 1) + 100 * (100 + 1)


def test_work_of_a_simulation_counts_interactions_of_forces_only():
    """Direct: N^2 an evaluation. Tree: fewer, and as many again in the next one. Diagnostics are not work."""
    for method, most in (("direct", 3000**2), ("tree", 0.5 * 3000**2)):
        sim = Simulation(scene({"method": method}))
        sim.sum_forces()
        first = sim.work()["interactions"]
        assert 0 < first <= most and (method == "tree" or first == most)
        sim.particles.position[0] += 1e-9
        sim.measure()
        assert sim.work()["interactions"] == first
        sim.sum_forces()
        assert sim.work()["interactions"] == pytest.approx(2 * first, rel=1e-3)
        assert sim.work()["forces"] == 2


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("softening", [0.0, 0.2])
def test_all_cells_open(d, softening):
    """With a tiny angle the tree is the direct sum: test particles, places shared by two and by more than a leaf holds."""
    random = np.random.default_rng(d)
    x, mass = random.standard_normal((700, d)), random.random(700)
    mass[::7] = 0.0
    x[10] = x[11]
    x[100:250] = x[100]
    result, exact = by_tree(x, mass, 1e-3, softening), by_pairs(x, mass, softening)
    np.testing.assert_allclose(result[:, :d], exact, rtol=1e-10, atol=1e-12 * np.abs(exact).max())
    assert (result[:, d:3] == 0.0).all()
    r2 = ((x[:, None] - x[None]) ** 2).sum(axis=2) + softening**2
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where((r2 > 0.0) & ~np.eye(700, dtype=bool), mass / np.sqrt(r2), 0.0)
    np.testing.assert_allclose(result[:, 3], -depth.sum(axis=1), rtol=1e-12)


@pytest.mark.parametrize("softening", [0.0, 3.0])
def test_far_cells_act_to_second_order(softening):
    """Mass and quadrupole of a cell: what they leave out of acceleration and potential falls with the fifth and fourth power."""
    random = np.random.default_rng(2)
    cloud, missing, depths = random.random((300, 3)), [], []
    for distance in (20.0, 40.0, 80.0):
        x = np.concatenate((cloud, [[distance, 0.6 * distance, -0.3 * distance]]))
        mass = np.concatenate((1.0 + cloud[:, 0], [0.0]))
        # Seen from a test particle far away the cloud is one cell.
        result, exact = by_tree(x, mass, 0.9, softening), by_tree(x, mass, 1e-3, softening)
        missing.append(np.abs(result[-1, :3] - exact[-1, :3]).max())
        depths.append(abs(result[-1, 3] - exact[-1, 3]))
    assert (np.log2(np.array(missing[:-1]) / missing[1:]) > 4.7).all()
    assert (np.log2(np.array(depths[:-1]) / depths[1:]) > 3.7).all()


@njit
def powers(r):
    """inverse_root and pull of numbers r (n,): (n, 2)."""
    found = np.empty((len(r), 2))
    for i in range(len(r)):
        found[i] = inverse_root(r[i]), pull(1.0, r[i])
    return found


def test_powers_are_exact_to_round_off():
    """r^(-1/2) and r^(-3/2) within 3e-16, at all scales; a root and a quotient are within 2.7e-16. 0 gives no pull."""
    r = 10.0 ** np.random.default_rng(7).uniform(-200.0, 200.0, 100_000)
    r[:1000] = 4.0 ** np.linspace(-1.0, 1.0, 1000)
    found, root = powers(r), 1.0 / np.sqrt(r.astype(np.longdouble))
    for k, exact in enumerate((root, root**3)):
        assert np.abs(found[:, k] / exact - 1.0).max() <= 3e-16
    assert powers(np.zeros(1))[0, 1] == 0.0


@njit
def short_powers(r):
    """The same in float32."""
    found = np.empty((len(r), 2), np.float32)
    for i in range(len(r)):
        found[i] = inverse_root(r[i]), pull(np.float32(1.0), r[i])
    return found


def test_powers_in_float32_are_exact_to_round_off():
    """Within 1.4e-7 and 1.7e-7: one to three units of float32's last place, 6e-8."""
    r = (10.0 ** np.random.default_rng(7).uniform(-20.0, 20.0, 100_000)).astype(np.float32)
    found, root = short_powers(r), 1.0 / np.sqrt(r.astype(float))
    for k, exact in enumerate((root, root**3)):
        assert np.abs(found[:, k] / exact - 1.0).max() <= 2.5e-7
    assert short_powers(np.zeros(1, np.float32))[0, 1] == 0.0


def test_float32_is_far_below_what_the_tree_leaves_out(sphere):
    """From SINGLE on all but the closest sources act in float32, and by an expansion: against float64 at the same angle.

    A dense core in the middle of a wide halo, masses of many sizes, and hundreds of close pairs, whose forces are the sum of two
    large numbers that float32 could not tell apart.
    """
    x, _, _ = sphere
    x = x[:4000].copy()
    x[:1000] *= 1e-3
    random = np.random.default_rng(6)
    x[3000:] = x[2000:3000] + 1e-9 * random.standard_normal((1000, 3))
    mass = random.random(4000) ** 8 + 1e-12
    single, double = (by_tree(x, mass, angle) for angle in (SINGLE, np.nextafter(SINGLE, 0.0)))
    assert single[:, :4].tobytes() != double[:, :4].tobytes()
    error = errors(single[:, :3], double[:, :3])
    assert np.median(error) <= 2e-7 and error.max() <= 5e-6
    np.testing.assert_allclose(single[:, 3], double[:, 3], rtol=1e-6)
    assert abs((single[:, 3] / double[:, 3] - 1.0).mean()) <= 5e-8  # no bias: energy does not drift


@pytest.mark.parametrize(("length", "weight"), [(200, 0), (-300, 0), (0, 500), (120, -400)])
def test_units_of_two_change_no_bit(sphere, length, weight):
    """Lengths times 2^k, masses times 2^j: accelerations times 2^(j - 2 k), potentials times 2^(j - k), float32 or not."""
    x, mass, _ = (part[:2000] for part in sphere)
    here = by_tree(x, mass, 0.6, 0.01)
    there = by_tree(np.ldexp(x, length), np.ldexp(mass, weight), 0.6, np.ldexp(0.01, length))
    assert np.ldexp(there[:, :3], 2 * length - weight).tobytes() == here[:, :3].tobytes()
    assert np.ldexp(there[:, 3], length - weight).tobytes() == here[:, 3].tobytes()


def test_few_bodies_have_the_bits_of_many():
    """In a dimension for which no kernel is compiled beforehand."""
    x, mass = np.random.default_rng(4).standard_normal((70, 4)), np.linspace(0.0, 1.0, 70)
    few = np.zeros_like(x)

    @njit
    def add(axes, x, mass, total):
        attract_few(axes, x, mass, 0.1**2, total)

    add((0,) * 4, x, mass, few)
    assert few.tobytes() == by_pairs(x, mass, 0.1).tobytes()


@njit
def expanded(cells, softening2, at):
    """Accelerations and potentials (n, 4) at places `at` (n, 3) by the expansion of cells (c, WIDTH) about the origin."""
    far, sums = (
        np.empty((CELLS // CELL_LANES, FAR_WIDTH, CELL_LANES), np.float32),
        np.zeros(COEFFICIENTS * CELL_LANES, np.float32),
    )
    coefficients, found = np.empty(2 * COEFFICIENTS), np.empty((len(at), 4))
    for c in range(len(cells)):
        enter_cell(far, c, (-cells[c, 1], -cells[c, 2], -cells[c, 3]), cells[c], 1.0, 1.0)
    expand(far, len(cells), np.float32(softening2), sums)
    add_lanes(sums, coefficients)
    for t in range(len(at)):
        found[t] = evaluate(coefficients, (at[t, 0], at[t, 1], at[t, 2]), coefficients[COEFFICIENTS:])
    return found


@pytest.mark.parametrize("softening", [0.0, 4.0])
def test_expansion_of_far_cells(softening):
    """Against the sum over all pairs: errors fall with the fourth power of the size of the group and of all cells together.

    That is the first power of the group's size that is left out of the acceleration. Cells leave out their moments from the third
    order on, but here those of odd orders are 0, since every particle has its mirror image. All sizes are so large that
    the round-off of float32, 6e-8 of a sum, is far below what is left out.
    """
    random = np.random.default_rng(3)
    middles = random.standard_normal((37, 3))
    middles *= random.uniform(5.0, 10.0, (37, 1)) / np.sqrt((middles**2).sum(axis=1, keepdims=True))
    shape, places, mass = random.standard_normal((37, 20, 3)), random.standard_normal((9, 3)), random.random((37, 20))
    wrong = []
    for size in (0.6, 0.3, 0.15):
        x = (middles[:, None] + size * np.concatenate((shape, -shape), axis=1)).reshape(-1, 3)
        m = np.concatenate((mass, mass), axis=1).ravel()
        cells, _ = moments(np.arange(1, 38), np.full(37, 40), x, m)
        found, exact = expanded(cells, softening**2, size * places), sum_over_pairs(size * places, x, m, softening)
        rho = np.sqrt(((x - size * places[:, None]) ** 2).sum(axis=2) + softening**2)
        wrong.append((np.abs(found[:, :3] - exact).max(), np.abs(found[:, 3] + (m / rho).sum(axis=1)).max()))
    order = np.log2(np.array(wrong[:-1]) / wrong[1:])
    assert (order[:, 0] > 3.7).all() and (order[:, 1] > 3.7).all()


places = st.integers(0, 2**32).flatmap(lambda seed: st.tuples(st.just(seed), st.integers(1, 400), st.sampled_from([1, 2, 3])))


@given(places)
@settings(max_examples=40)
def test_no_cell_is_far_from_what_is_in_it(drawn):
    """At an opening angle of 1 and any masses; radii hold all particles; every particle is in one leaf and one group."""
    seed, n, d = drawn
    random = np.random.default_rng(seed)
    x = np.zeros((n, 3))
    x[:, :d] = random.standard_normal((n, d)) * 10.0 ** random.uniform(-6, 2, (n, 1))
    mass = 10.0 ** random.uniform(-12, 6, n)
    extent = float((x.max(axis=0) - x.min(axis=0)).max())
    keys = morton(x, x.min(axis=0), 2.0 ** levels(d) / max(2.0 * extent, 1e-9), d)
    order = np.argsort(keys, kind="stable")
    level, count, groups, branches = divide(keys[order], d, 0, np.iinfo(np.int64).max)
    assert count.sum() == n and len(branches) == 1
    assert (np.diff(groups, axis=1) <= GROUP).all() and groups[0, 0] == 0 and groups[-1, 1] == n
    assert (groups[1:, 0] == groups[:-1, 1]).all()
    skip = skips(level, np.zeros(1, np.int64))
    cells, _ = moments(skip, count, x[order], mass[order])
    assert cells[0, MASS] == pytest.approx(mass.sum(), rel=1e-12)
    first = np.cumsum(count) - count
    ends = np.append(first, n)
    for node in range(len(level)):
        inside = x[order][first[node] : ends[skip[node]]]
        away = np.sqrt(((inside - cells[node, CENTER : CENTER + 3]) ** 2).sum(axis=1))
        assert away.max() <= cells[node, RADIUS]
        for begin, end in groups:
            low, high = max(begin, first[node]), min(end, ends[skip[node]])
            if low < high:
                box = x[order][begin:end].min(axis=0), x[order][begin:end].max(axis=0)
                c = cells[node, CENTER : CENTER + 3]
                gap = np.maximum(np.maximum(box[0] - c, c - box[1]), 0.0)
                assert (gap**2).sum() <= cells[node, RADIUS] ** 2


def scene(gravity, **more):
    tables = {
        "dimension": 3,
        "G": 1.0,
        "time": {"step": 0.01, "steps": 1},
        "particles": [{"count": 3000, "position": {"plummer": 1.0}, "velocity": "equilibrium", "mass": 1.0 / 3000}],
        "effects": {"mutual_gravity": gravity},
    }
    return Scene(**tables | more)


def test_potential_energy_with_and_without_fixed_particles():
    """As by direct sum; the potential of the last force is used again where that is right."""
    fixed = [{"position": [[0.5, 0.0, 0.0]], "mass": 0.5, "fixed": True}]
    for particles in ([], fixed):
        tables = [*scene({}).to_dict()["particles"], *particles]
        sums = [Simulation(scene({"method": method, "softening": 0.01}, particles=tables)) for method in ("direct", "tree")]
        direct, tree = (sim.measure()["potential"] for sim in sums)
        assert tree == pytest.approx(direct, rel=2e-5)
        sums[1].sum_forces()
        assert sums[1].measure()["potential"] == pytest.approx(tree, rel=1e-13)
        sums[1].particles.position[0] += 5.0
        assert sums[1].measure()["potential"] != pytest.approx(tree, rel=1e-5)


def test_plummer_sphere_of_a_scene():
    """reference/README.md: E = -3 pi/64, 2 K/|W| = 1, half-mass radius 1.3047660; at rest as a whole."""
    sim = Simulation(Scene.load("particles_mpi/scenes/plummer.toml"))
    row = sim.measure()
    assert row["total_energy"] == pytest.approx(-3.0 * np.pi / 64.0, rel=0.02)
    assert row["virial_ratio"] == pytest.approx(1.0, abs=0.02)
    radius = np.sqrt((sim.particles.position**2).sum(axis=1))
    assert np.median(radius) == pytest.approx(1.3047660, rel=0.02)
    for name in ("momentum_x", "momentum_y", "center_x", "center_z"):
        assert abs(row[name]) < 1e-15


@pytest.mark.parametrize(("method", "bound"), [("tree", 1e-3), *with_all(("direct", 1e-4))])
def test_energy_over_ten_dynamical_times(method, bound):
    """A Plummer sphere of 1000; (3 pi/(16 G rho))^(1/2) within the half-mass radius is 3.3."""
    particles = [{"count": 1000, "position": {"plummer": 1.0}, "velocity": "equilibrium", "mass": 1e-3}]
    time = {"step": 0.02, "end": 33.0}
    sim = Simulation(scene({"method": method, "softening": 0.05}, particles=particles, time=time))
    before = sim.measure()
    sim.run()
    after = sim.measure()
    assert abs(after["total_energy"] / before["total_energy"] - 1.0) <= bound
    assert abs(after["momentum_x"]) <= (1e-15 if method == "direct" else 1e-4)


def test_auto_takes_what_costs_less_and_says_so():
    few, many, exact = (choose("auto", 0.5, accuracy, 3, n) for accuracy, n in ((1e-3, 500), (1e-3, 100_000), (1e-9, 100_000)))
    assert few.angle is None and exact.angle is None
    assert many.angle == pytest.approx(0.6, abs=0.02)
    assert "tree" in many.words and "median error of 0.001" in many.words and "times the work" in many.words
    assert choose("auto", 0.5, 1e-3, 4, 100_000).angle is None
    quad, mono = (choose("tree", 0.5, 1e-3, 3, 100_000, multipole) for multipole in ("quadrupole", "monopole"))
    assert mono.cost < quad.cost and mono.words == quad.words + ", monopoles"
    mass = np.full(5000, 1.0 / 5000)
    x = plummer_places(np.random.default_rng(3), 1.0, mass)
    for accuracy in (1e-4, 1e-3, 5e-3):  # what it promises
        angle = choose("auto", 0.5, accuracy, 3, 10**6).angle
        assert np.median(errors(by_tree(x, mass, angle)[:, :3], by_pairs(x, mass))) <= accuracy


@pytest.mark.parametrize(
    ("gravity", "dimension", "fault"),
    [
        ({"method": "tree"}, 4, 'method: there is no tree in dimension 4; use "direct"'),
        ({"method": "auto", "opening_angle": 0.5}, 3, 'opening_angle: method "auto" chooses it; give accuracy'),
        ({"method": "tree", "accuracy": 1e-3}, 3, 'accuracy: only with method "auto"'),
        ({"multipole": "monopole"}, 3, 'multipole: "monopole" only with method "tree"'),
        ({"method": "auto", "multipole": "monopole"}, 3, 'multipole: "monopole" only with method "tree"'),
        ({"method": "tree", "multipole": "octupole"}, 3, "multipole: must be 'quadrupole' or 'monopole'"),
        ({"method": "tree", "opening_angle": 1.5}, 3, "opening_angle: must be less than or equal to 1"),
    ],
)
def test_mutual_gravity_faults(gravity, dimension, fault):
    with pytest.raises(SceneError, match=f"effects.mutual_gravity.{fault}"):
        scene(gravity, dimension=dimension, particles=[{"position": [[0.0] * dimension]}])


def test_numbers_that_are_not_finite():
    """All accelerations are nan, on all ranks alike, and the run stops by name."""
    x = np.random.default_rng(0).random((10, 3))
    x[3, 1] = np.inf
    assert np.isnan(by_tree(x, np.ones(10), 0.5)).all()
