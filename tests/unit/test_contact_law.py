"""The contact law is written twice, for arrays of positions and velocities and for rows of mode event: the same bits.

And for smooth and for rough spheres, pairs and walls: the same but for round-off.
"""

import numpy as np
import pytest
from numba import njit

from particles_mpi.contacts import law
from particles_mpi.contacts.event_driven import segments
from particles_mpi.contacts.rough import Rough, strike_pair, strike_wall
from particles_mpi.contacts.velocity_flow import Rates, no_rates
from particles_mpi.contacts.walls import bounce
from particles_mpi.kernels.geometry import boxes_per_length
from particles_mpi.kernels.markers import NEVER, RADIUS, START
from particles_mpi.kernels.motion import Segments, move_to
from particles_mpi.neighbours.candidates import Spheres
from particles_mpi.neighbours.verlet_kernels import INVERSE_MASS


def pairs(d, count):
    """Pairs of spheres on segments that began at different times, in a box of side 4 that is periodic along some axes."""
    random = np.random.default_rng(d)
    for _ in range(count):
        length = np.where(random.random(d) < 0.5, 4.0, 0.0)
        x, v, radius = random.uniform(0.0, 4.0, (2, d)), random.normal(size=(2, d)), random.uniform(0.1, 0.8, 2)
        start = np.where(random.random(2) < 0.3, 0.0, random.uniform(0.0, 0.5, 2))
        w = np.where(random.random(2) < 0.2, 0.0, random.uniform(0.1, 3.0, 2))
        if not w.any():
            w[0] = 1.0
        segment = np.empty((2, 2 * d + 2))
        segment[:, :d], segment[:, d : 2 * d] = x, v
        segment[:, 2 * d + START], segment[:, 2 * d + RADIUS] = start, radius
        reference = np.zeros((2, d + 3))
        reference[:, d + INVERSE_MASS] = w
        yield Segments(x, v, start, np.zeros(2, np.int64)), radius, w, segment, reference, length, random


def is_same(one, other):
    return np.asarray(one).tobytes() == np.asarray(other).tobytes()


@njit
def may_touch(axes, segment, i, rows, place, now, until, length, per_length):
    """Bit p: may row i touch the row rows[p]?"""
    others = segments.columns_of_segments(axes, segment, rows, 0, len(rows) - 1)
    return segments.may_touch(axes, segment, i, others, place, now, until, length, per_length)


@pytest.mark.parametrize("d", [1, 2, 3, 4])
def test_the_time_of_a_contact(d):
    touched = 0
    for (x, v, start, _), radius, _, segment, _, length, random in pairs(d, 1000):
        axes, r, u, now = (0,) * d, np.empty(d), np.empty(d), start.max()
        t = law.contact_time.py_func(axes, x, v, start, 0, 1, radius.sum(), 2.0, length)
        assert is_same(t, segments.touch_time(axes, segment, 0, 1, now, 2.0, 2.0, length, r, u))
        later = min(t, 2.0) if random.random() < 0.1 else random.uniform(now, min(t, 2.0))
        for moment in (now, later):
            place = x[0] + v[0] * (moment - start[0])
            several = np.tile(np.array([1, 0], np.int32), 3)  # and from the sixth on the last one is repeated
            bits = may_touch(axes, segment, 0, several, place, moment, 2.0, length, boxes_per_length(length))
            if d == 1:  # where a row is together with itself, which is in no list of its own
                bits &= 0b00010101
            assert bits in (0b00010101, 0) if t == NEVER else bits == 0b00010101
        touched += t != NEVER
    assert touched > 20


def spinning(d, w, random, surface):
    """Random spins of two spheres, one of them perhaps without a moment of inertia, with the surface (mu, beta_0)."""
    turn = np.where(w > 0.0, random.uniform(0.0, 9.0, 2), 0.0)
    law_of = np.array([surface, surface])
    return Rough(random.normal(size=(2, d * (d - 1) // 2)), turn, law_of, np.empty(d), np.empty(d))


@pytest.mark.parametrize(
    ("d", "surface"), [(1, (0.0, 0.0)), (2, (0.0, 0.0)), (3, (0.0, 0.0)), (2, (0.3, 0.5)), (3, (0.3, 0.5)), (3, (np.inf, -0.5))]
)
@pytest.mark.parametrize("changing", [False, True])
def test_what_a_contact_does(d, surface, changing):
    """On a line the rows of mode event take r = 1 for the normal, which rounds otherwise: there, equal to round-off."""
    collided = 0
    for parts, radius, w, segment, reference, length, random in pairs(d, 1000):
        x, v, start, _ = parts
        axes, r = (0,) * d, np.empty(d)
        t = law.contact_time.py_func(axes, x, v, start, 0, 1, radius.sum(), 2.0, length)
        if t == NEVER:
            continue
        rates = Rates(random.normal(size=(2, d)), random.uniform(0.0, 0.3, 2), 0.1, 1.0) if changing else no_rates(d)
        loss = law.Loss(random.choice([1.0, 0.5, 0.0]), random.choice([1.0, 0.9]))
        rough = spinning(d, w, random, surface)
        again = rough._replace(spin=rough.spin.copy())
        spheres = Spheres(radius, w, np.arange(2), 2)
        virial = law.collide_pair(axes, parts, spheres, 0, 1, t, loss, length, rates, rough, r)
        other = segments.collide(axes, segment, reference, 0, 1, t, loss, length, rates, again, False, r)
        collided += 1
        assert is_same(rough.spin, again.spin)
        assert is_same(segment[:, :d], x) and is_same(segment[:, 2 * d + START], start)
        if d > 1:
            assert is_same(segment[:, d : 2 * d], v) and is_same(other, virial)
        else:
            assert np.allclose(segment[:, d : 2 * d], v, rtol=1e-12, atol=1e-14) and np.isclose(other, virial, rtol=1e-12, atol=0)
    assert collided > 20


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("changing", [False, True])
def test_smooth_contacts_are_rough_ones_without_friction(d, changing):
    """The law stands in three places for velocities of the moment of a contact: for pairs, for walls, and for rough spheres."""
    changed = 0
    for (_, v, _, _), radius, w, _, _, _, random in pairs(d, 1000):
        axes, r, at, t = (0,) * d, random.normal(size=d), np.int64(0), random.uniform(0.0, 2.0)
        rates = Rates(random.normal(size=(2, d)), random.uniform(0.0, 0.3, 2), 0.1, 1.0) if changing else no_rates(d)
        e, rough = random.choice([1.0, 0.5, 0.0]), spinning(d, w, random, (0.0, 0.0))
        smooth, like = v.copy(), v.copy()
        approach = r @ (v[0] - v[1])
        if approach < 0.0:
            bodies = w[0], w[1], radius[0], radius[1]
            change = law.apply_impulse(axes, smooth, at, r, 0, 1, w[0], w[1], t, e, 1.0, rates)
            assert change == pytest.approx(strike_pair(axes, like, at, rough, r, 0, 1, bodies, t, e, rates), rel=1e-12)
            np.testing.assert_allclose(smooth, like, rtol=1e-12, atol=1e-13)
            changed += change != (1.0 + e) * approach
        if w[0] > 0.0 and v[0] @ r < 0.0:
            normal, smooth, like = (r / np.linalg.norm(r))[None, :], v.copy(), v.copy()
            bounce(axes, smooth, at, 0, 0, normal, e, 1.0, w[0], t, rates)
            strike_wall(axes, like, at, rough, 0, 0, normal, w[0], radius[0], t, e, rates)
            np.testing.assert_allclose(smooth, like, rtol=1e-12, atol=1e-13)
            assert normal[0] @ smooth[0] > -1e-13
    assert not changing or changed > 100


def test_the_way_along_a_segment():
    for (x, v, start, _), _, _, segment, _, _, random in pairs(3, 50):
        t = random.uniform(0.5, 2.0)
        move_to((0,) * 3, x, v, start, 1, t)
        segments.move_to((0,) * 3, segment, 1, t)
        assert is_same(segment[:, :3], x) and is_same(segment[:, 6 + START], start)
