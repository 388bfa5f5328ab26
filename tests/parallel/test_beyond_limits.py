"""Nothing wraps: where a rank would have more than 32 bits can count, a run ends with one line that says so, on all ranks."""

import pytest
from conftest import run_ranks

pytestmark = pytest.mark.parallel
SCENE = """
dimension = 3
[box]
lower = [0, 0, 0]
upper = [1, 1, 1]
[time]
step = 0.01
steps = 20
[[particles]]
count = 60
position = "lattice"
velocity = {{speed = 1.0}}
radius = 0.04
mass = 1.0
[effects.collisions]
mode = "{mode}"
[effects.walls]
"""


@pytest.mark.parametrize(
    "ranks, when, limit, mode, code, fresh, said",
    [
        (2, "setup", 29, "rewind", 2, True, "more than 29 particles on a rank: use more ranks"),
        (2, "setup", 31, "rewind", 3, False, "spheres, or cells for them, on one rank, more than 31: use more ranks"),
        (2, "steps", 40, "rewind", 3, True, "particles and ghosts on one rank, more than 40: use more ranks"),
        (1, "steps", 1500, "event", 3, False, "2224 places in lists of neighbours on one rank, more than 1500: use more ranks"),
        (2, "steps", 1500, "event", 3, False, "2224 places in lists of neighbours on one rank, more than 1500: use more ranks"),
        (2, "steps", 59, "event", 3, False, "60 rows of all ranks on one rank, more than 59: use more ranks"),
    ],
)
def test_a_run_that_cannot_be_counted_ends_with_one_line(tmp_path, ranks, when, limit, mode, code, fresh, said):
    (tmp_path / "scene.toml").write_text(SCENE.format(mode=mode))
    words = ("run", tmp_path / "scene.toml", "--output", tmp_path / "out", "--quiet")
    done = run_ranks(ranks, "tests/parallel/limited.py", when, limit, *words, fresh=fresh)
    assert done.returncode == code, done.stderr
    lines = done.stderr.splitlines()
    assert len(lines) == 1 and lines[0].startswith("particles-mpi: ") and lines[0].endswith(said), done.stderr
    assert not list(tmp_path.glob("out/**/*.tmp"))  # nothing half-written
