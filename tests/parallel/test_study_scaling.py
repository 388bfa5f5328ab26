"""`study scaling` for real, on scenes of a few particles: what is told and written, not how fast it is."""

import csv
import os

import pytest
from conftest import run_ranks

from particles_mpi.study.scaling.performance_model import Law

pytestmark = pytest.mark.parallel
FILES = {"scaling.csv", "scaling_model.csv", "scaling.png", "scaling.svg"}


def scaled(ranks, folder, scene, *more):
    done = run_ranks(ranks, "tests/parallel/scale_scene.py", folder, scene, *more, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def table(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_two_ranks(tmp_path):
    said = scaled(2, tmp_path, "gas")
    assert {path.name for path in tmp_path.iterdir()} == FILES
    assert (tmp_path / "scaling.png").read_bytes().startswith(b"\x89PNG") and "<svg" in (tmp_path / "scaling.svg").read_text()
    rows = table(tmp_path / "scaling.csv")
    assert [(row["curve"], row["ranks"], row["particles"]) for row in rows] == [
        ("strong, N = 2000", "1", "2000"),
        ("strong, N = 2000", "2", "2000"),
        ("weak, N/P = 2000", "1", "2000"),
        ("weak, N/P = 2000", "2", "4000"),
    ]
    for row in rows:
        seconds = {name: float(value) for name, value in row.items() if name.startswith("seconds_")}
        whole = seconds.pop("seconds_per_step")
        assert 0.0 < float(row["quartile_1"]) <= whole <= float(row["quartile_3"])
        assert sum(seconds.values()) == pytest.approx(whole, rel=0.2)  # the phases; rounding of clocks
        alone = row["ranks"] == "1"
        assert (float(row["messages"]) == float(row["ghost_rows"]) == float(row["reductions"]) == 0.0) == alone
        assert float(row["speedup"]) == pytest.approx(float(row["efficiency"]) * int(row["ranks"]))
    assert all(line.split()[0] in said for line in ("1 ", "2 ")) and said.count("speed-up") == 2
    if len(os.sched_getaffinity(0)) > 1:
        assert "MODEL, extrapolated from 1 to 2 ranks of one machine" in said and "oversubscribed" not in said
    assert said.count("what ends the scaling (") == 2
    assert said.count("assumed: ") == 5 and "error of the model where it was fitted: N = 2000 on 1: " in said
    predicted = table(tmp_path / "scaling_model.csv")
    assert {row["kind"] for row in predicted} == {"model"}
    assert [int(row["ranks"]) for row in predicted] == [1 << k for k in (*range(11), 16)] * 2
    assert all(float(row["seconds_per_step"]) > 0.0 for row in predicted)


@pytest.mark.slow
def test_ranks_without_a_core_are_marked(tmp_path):
    ranks = 2 * len(os.sched_getaffinity(0))
    said = scaled(ranks, tmp_path, "gas")
    assert said.count(f"{ranks}, oversubscribed") == 4  # in two tables of two curves
    rows = table(tmp_path / "scaling.csv")
    marked = {row["ranks"]: row["oversubscribed"] for row in rows}
    assert marked["1"] == "0" and marked[str(ranks)] == "1"
    assert "hollow: oversubscribed" in (tmp_path / "scaling.svg").read_text()
    law = Law("N", (1.0, 1.0, 1.0), (False, False, False))  # ghosts lie in a layer as thick on two ranks as on all
    counted = [(row, float(row["rows"]) / float(row["fetches"])) for row in rows if row["ranks"] in ("2", str(ranks))]
    layers = [law.thickness(int(row["particles"]), int(row["ranks"]), fetched) for row, fetched in counted]
    assert max(layers) < 2.0 * min(layers), layers


def test_listed_particles_have_no_weak_scaling(tmp_path):
    said = scaled(2, tmp_path, "listed")
    assert "no weak scaling: particles[0].position: is a list, with a value for each particle" in said
    assert {row["curve"] for row in table(tmp_path / "scaling.csv")} == {"strong, N = 3"}


def test_a_cluster_by_tree(tmp_path):
    said = scaled(2, tmp_path, "cluster")
    assert "weak, N/P = 600" in said and "work = N log N" in said


def test_one_rank_has_no_model(tmp_path):
    said = scaled(1, tmp_path, "gas")
    assert "no model: on one rank nothing is sent" in said and "MODEL" not in said
    assert {path.name for path in tmp_path.iterdir()} == FILES - {"scaling_model.csv"}


def test_a_folder_that_cannot_be_is_one_error_on_all(tmp_path):
    (tmp_path / "file").write_text("")
    done = run_ranks(2, "tests/parallel/scale_scene.py", tmp_path / "file" / "under", "gas")
    assert done.returncode == 3 and "cannot write into" in done.stderr


def test_counts(tmp_path):
    said = scaled(2, tmp_path, "gas", "counts")
    assert {path.name for path in tmp_path.iterdir()} == {"counts.csv", "counts_model.csv"}
    rows = {(row["curve"].split(",")[0], row["ranks"]): row for row in table(tmp_path / "counts.csv")}
    assert [int(rows[key]["particles"]) for key in rows] == [4000, 4000, 2000, 4000]
    for (_, ranks), row in rows.items():
        number = {name: float(value) for name, value in row.items() if name not in ("scene", "curve")}
        kinds = [number[f"bytes_{kind}"] for kind in ("rows", "counts", "gathers", "reductions")]
        assert number["bytes"] == pytest.approx(sum(kinds)) and all(
            number[name] <= number[f"{name}_largest"] for name in ("bytes", "memory")
        )
        assert 0.3 < number["memory"] < 5.0 and number["memory_start"] > 0.1
        if ranks == "1":
            assert number["bytes"] == number["messages"] == number["ghosts"] == 0.0
        else:
            assert 0.1 <= number["fetches"] <= 0.3  # each SEARCH_INTERVAL steps, or more often
            assert number["bytes_counts"] == pytest.approx(4 * number["all_to_alls"])  # a count of 4 bytes to the other rank
            assert number["bytes_gathers"] == pytest.approx(6 * 8 * number["fetches"])  # a box to the other rank
            assert number["bytes_rows"] > 8 * 6 * number["ghosts"] * number["fetches"]  # x and v of each
    assert rows["strong", "2"] | {"curve": ""} == rows["weak", "2"] | {"curve": ""}  # the same setting, counted once
    assert {row["kind"] for row in table(tmp_path / "counts_model.csv")} == {"model"}
    assert "MODEL, extrapolated from 1 rank" in said and said.count("what ends the scaling (") == 2
    assert "which columns are flat is judged only from 8 ranks on" in said


def test_counts_in_mode_event(tmp_path):
    scaled(2, tmp_path, "events", "counts")
    rows = {(row["curve"].split(",")[0], row["ranks"]): row for row in table(tmp_path / "counts.csv")}
    assert float(rows["strong", "1"]["ghosts"]) == 0.0 < float(rows["strong", "2"]["ghosts"]) < 2000


def test_what_is_listed_is_counted_too(tmp_path):
    said = scaled(2, tmp_path, "listed", "counts")
    assert {row["curve"] for row in table(tmp_path / "counts.csv")} == {"strong, N = 3"} and "weak" not in said
