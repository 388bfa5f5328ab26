"""Random numbers by particle: the generator's published answers, and that whoever draws them gets the same."""

import numpy as np
import pytest

from particles_mpi.initial.random_numbers import GENERATOR_BLOCK, draw, random_pair, stream_key, uniform

ANSWERS = (  # key, counter, output of Philox4x32-10: known answers that come with its authors' library Random123
    ((0, 0), (0, 0, 0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((0xFFFFFFFF,) * 2, (0xFFFFFFFF,) * 4, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0xA4093822, 0x299F31D0),
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
)


@pytest.mark.parametrize(("key", "counter", "words"), ANSWERS)
def test_the_published_answers_of_philox(key, counter, words):
    """The 53 highest bits of each pair of words."""
    pair = random_pair(*map(np.uint64, key + counter))
    assert pair == tuple(((words[k] << 32 | words[k + 1]) >> 11) * 2.0**-53 for k in (0, 2))


@pytest.mark.parametrize("numbers", [uniform, lambda random, n: random.standard_normal((n, 3))])
def test_parts_of_a_population_are_those_of_the_whole(numbers):
    key = stream_key(7, 3, "velocity")
    whole = draw(key, 0, 3 * GENERATOR_BLOCK, numbers)
    n = GENERATOR_BLOCK
    for first, last in [(0, 1), (0, 0), (5, 5), (3, n), (n - 1, n + 1), (10, 3 * n), (2 * n, 2 * n + 9)]:
        assert np.array_equal(draw(key, first, last, numbers), whole[first:last])
    assert len(np.unique(whole)) == whole.size


def test_seeds_populations_and_quantities_have_numbers_of_their_own():
    keys = [stream_key(s, p, q) for s in (1, 2) for p in (0, 1, 9) for q in ("position", "speed", "drag", "charge", "spin")]
    assert len({draw(key, 0, 1, uniform)[0] for key in keys}) == len(keys)
