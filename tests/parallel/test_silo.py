"""The scene of the silo, with fewer spheres and a shorter time: they fall past fixed ones onto tilted planes and come to rest."""

import numpy as np
import pytest
from conftest import ROOT, run_ranks
from scipy.spatial import cKDTree

from particles_mpi import Run

pytestmark = pytest.mark.parallel


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """On one rank and on two."""
    folder = tmp_path_factory.mktemp("silo")
    text = (ROOT / "particles_mpi" / "scenes" / "silo.toml").read_text()
    assert "count = 2000" in text and "end = 2.0" in text
    (folder / "silo.toml").write_text(text.replace("count = 2000", "count = 60").replace("end = 2.0", "end = 1.5"))
    for ranks in (1, 2):
        words = "run", folder / "silo.toml", "--output", folder / str(ranks), "--quiet"
        done = run_ranks(ranks, "-m", "particles_mpi", *words, timeout=300)
        assert done.returncode == 0, done.stderr
    return Run(folder / "1"), Run(folder / "2")


def test_the_same_bits_on_one_rank_and_on_two(runs):
    one, two = runs
    assert len(one) == len(two) == 31
    for a, b in zip(one, two, strict=True):
        assert all(a[name].tobytes() == b[name].tobytes() for name in a.fields)


def test_they_come_to_rest_between_the_planes_and_do_not_overlap(runs):
    run, _ = runs
    kinetic = run.columns["kinetic"]
    assert kinetic[-1] < 1e-3 * kinetic.max()
    last = run[-1]
    for plane in run.scene.effects["walls"].planes:
        normal = np.array(plane.normal) / np.linalg.norm(plane.normal)
        assert ((last.position - plane.point) @ normal - last.radius).min() > -1e-4
    i, j = cKDTree(last.position).query_pairs(2 * last.radius.max(), output_type="ndarray").T
    gap = np.linalg.norm(last.position[i] - last.position[j], axis=1) - last.radius[i] - last.radius[j]
    assert gap.min() > -1e-4
    moved = last.position[last.fixed == 0] - run[0].position[last.fixed == 0]
    assert (last.position[last.fixed != 0] == run[0].position[last.fixed != 0]).all() and moved[:, 2].mean() < -0.5
