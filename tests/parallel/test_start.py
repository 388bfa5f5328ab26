"""The start of a scene is the same on any number of ranks, faults and all; and no rank holds what others hold."""

import json
import math

import pytest
from conftest import run_ranks
from with_all import with_all

pytestmark = pytest.mark.parallel
FILES = {
    "rows.csv": "x,y,note\n" + "".join(f"{0.01 * k:.4f},0.5,{k}\n" for k in range(1, 99)),
    "bare.csv": "\n".join(f"{k},-{k},{'long' * (k % 13)}" for k in range(1, 99)),
    "oops.csv": "0.1,0.2\n" * 70 + "0.3,oops\n" + "0.1,0.2\n" * 5 + "0.1\n",
    "nan.csv": "x,y\n" + "0.1,0.2\n" * 70 + "0.3,nan\n" * 7,
    "empty.csv": "x,y\n",
}
SAID = {
    "a file that cannot be read": "oops.csv: line 71: ",
    "a file with a number that is none": "nan.csv: lines 72, 73, 74, 75, 76 and 2 more: a number is not finite",
    "an empty file": "empty.csv holds no rows",
    "no file": "none.csv cannot be read (No such file",
    "overlaps": "effects.collisions: pairs 0-97, 1-98 and 2-99 overlap (deepest by ",
    "outside": "box: particles 51, 52, 53, 54, 55 and 4 more outside",
    "in walls": "effects.walls.planes[0]: particle 0 not fully on the free side of the wall at (0, 0)",
    "too fast": "time.step: particles ",
    "too many": "particles[0].position: random: ",
    "too wide": "particles[0].position: random: spheres of radius 0.6 do not fit into the box on axis 0",
    "masses": "particles[0].mass: [effects.collisions] divides by it, so it must be above 0 for"
    " particles 0, 3, 6, 9, 12 and 5 more",
    "warm and massless": "a temperature needs a mass for particles 0, 3, 6, 9, 12 and 5 more",
}
WARNED = {
    "pushed apart": "; pushed apart",
    "at one place": "pairs 0-1, 2-3, 4-5, 6-7, 8-9 and 5 more are at the same place: ",
    "endless falls": "user_acceleration: not zero for particle 17 along periodic axis 0",
}


@pytest.fixture(scope="module")
def started(tmp_path_factory):
    """{ranks: what is told of each scene}."""
    folder = tmp_path_factory.mktemp("files")
    for name, text in FILES.items():
        (folder / name).write_text(text)
    told = {}

    def start(ranks):
        if ranks not in told:
            done = run_ranks(ranks, "tests/parallel/start.py", folder, timeout=300)
            assert done.returncode == 0, done.stderr[-2000:]
            told[ranks] = json.loads(done.stdout)
        return told[ranks]

    return start


@pytest.mark.parametrize("ranks", [3, *with_all(2, 4, 7, 8)])
def test_same_start_on_any_number_of_ranks(started, ranks):
    """Every field to the bit, warnings and faults word by word."""
    one, several = dict(started(1)), dict(started(ranks))
    memory = [told.pop("bytes a particle") for told in (one, several)]
    assert one == several
    assert memory[1] < 1.5 * memory[0] / ranks + 25.0  # the part of a rank, some ghosts, and buffers of messages


def test_what_is_wrong_is_told(started):
    told = started(1)
    for name, says in SAID.items():
        assert len(told[name]) == 1 and says in told[name][0], told[name]
    for name, says in WARNED.items():
        assert len(told[name]) == 2 and says in told[name][1], told[name]
    good = [what for name, what in told.items() if name not in SAID and name != "bytes a particle"]
    assert len({what[0] for what in good}) == len(good) and math.isfinite(told["bytes a particle"])


def test_starts_stay_as_they_are(started):
    """Another digest means another start of a user's scene. Without powers and logarithms, in which CPUs may differ."""
    told = started(1)
    assert {name: told[name][0][:16] for name in PINNED} == PINNED


PINNED = {
    "discs": "35dbca80bd58d313",
    "periodic discs": "ef5a6be05bce8ee9",
    "spheres": "4a519d55c71e1be8",
    "rods": "746ff016a3cd41c9",
    "five dimensions": "6c86b764dff756cf",
    "a slope": "72391f38f2d5ab0f",
    "free points": "98df6947ceeff1e4",
    "a lattice": "8f56f79ad8bfaf66",
    "a crystal": "ba594ee19fe1f6e6",
    "pushed apart": "6326a9bce9546d70",
    "a file": "time.step: parti",
}
