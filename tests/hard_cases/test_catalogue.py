"""The catalogue of hard cases: what must hold, holds."""

from functools import partial

import pytest

from particles_mpi.study.hard_cases.catalogue import catalogue, examine, settings, where

# Cases that take seconds, by the beginnings of their names: the modes and dimensions that run without --all.
HEAVY = {
    "resting ball": (),  # test_rest.py has them, and looks at more
    "resting columns": (),
    "beds of 200": (),  # test_lasting.py has one of rough spheres, which slide and roll besides
    "bed of 10 000": (),  # half a minute each
    "a pyramid of three discs": (("event", 3),),
    "a ball that spins in a groove": (("rewind", 2),),
    "1e5 bounces of an elastic ball": (("event", 2), ("event", 3)),
    "1e5 bounces under gravity": ((None, 2),),
    "1e6 Kepler orbits": (),
    "close encounter, e = 0.999, not softened": ((None, 2),),
}


def parameters():
    """All cases that take less than minutes, in each of their modes and dimensions."""
    for one, mode, dimension in settings([one for one in catalogue() if not one.long]):
        few = next((few for name, few in HEAVY.items() if one.name.startswith(name)), ((mode, dimension),))
        marks = () if (mode, dimension) in few else pytest.mark.slow
        yield pytest.param(one, mode, dimension, marks=marks, id=f"{one.name}, {where(mode, dimension)}")


WHOLE = {("bed of 10 000, 3 s, e = 0.9", "event"), ("bed of 10 000, 3 s, e = 0.5", "rewind")}  # the others of these are smaller
FEWER = 3000  # large piles as well: contacts are solved by all ranks together


@pytest.mark.parametrize(("one", "mode", "dimension"), list(parameters()))
def test_what_must_hold(one, mode, dimension):
    if one.name.startswith("bed of 10 000") and (one.name, mode) not in WHOLE:
        one = one._replace(function=partial(one.function, count=FEWER))
    outcome = examine(one, mode, dimension)
    assert outcome.holds, f"{one.must}; measured: {outcome.measured}"
