"""Run by test_study_scene.py on several ranks: errors of settings of a scene to the bit, then `recommend` and `predict`."""

import json
import sys
from pathlib import Path

from mpi4py import MPI

from particles_mpi import Scene, Simulation
from particles_mpi.study.experiment import Benchmark
from particles_mpi.study.recommend.methods import methods
from particles_mpi.study.recommend.predict import predict
from particles_mpi.study.recommend.recommend import recommend
from particles_mpi.study.recommend.reference import reference
from particles_mpi.study.recommend.runs import Start
from particles_mpi.study.recommend.search import Search

folder = Path(sys.argv[1])
edge = 6.0
gas = {"count": 100, "position": "random", "velocity": {"temperature": 1.0}, "radius": 0.5, "mass": 1.0}
fallen = {"count": 80, "position": "random", "velocity": [1.0, 0.0, 2.0], "radius": 0.01, "mass": {"min": 1.0, "max": 2.0}}
box = {"lower": [0.0] * 3, "upper": [edge] * 3, "periodic": True}
SCENES = {
    "gas": {"particles": [gas], "time": {"step": 0.02, "steps": 12}, "effects": {"collisions": {}}},
    "pulled": {
        "particles": [fallen],
        "time": {"step": 0.05, "steps": 8},
        "effects": {"drag": {"rate": 0.7}, "uniform_gravity": {"acceleration": [0.0, 0.0, -9.81]}, "friction": {"strength": 0.1}},
    },
}
found = {}
for name, tables in SCENES.items():
    lab = Benchmark(quick=True, samples=2)
    start = Start(lab, Scene.from_dict({"dimension": 3, "seed": 4, "box": box, **tables}))
    metric = reference(start, 1e4)
    error = next(iter(metric.limits))
    search = Search(start, metric, {error: 0.1}, 1e4)
    for method in methods(start):
        search.attempt(method, 2.0 * start.scene.steps)
    rows = {trial.name: {what: wrong.hex() for what, wrong in trial.errors.items()} for trial in search.trials}
    found[name] = {"floors": {what: floor.hex() for what, floor in metric.limits.items()}, "rows": rows}
    if name == "pulled":
        continue
    result = recommend(lab, start.scene, 0.1, error, 20.0)
    assert result.best.errors[error] <= 0.1 and result.search.start.benchmark.ranks.size == lab.ranks.size
    same = lab.ranks.allgather((result.tables, result.best.timed, predict(Simulation(start.scene, comm=lab.comm), lab)))
    assert all(one == same[0] for one in same), "ranks disagree"
few = {"dimension": 2, "particles": [{"position": [[0.0, 0.0]], "velocity": [1.0, 1.0]}], "time": {"step": 0.1, "steps": 10}}
few["effects"] = {"drag": {"rate": 1.0}}
alone = recommend(Benchmark(quick=True, samples=2), Scene.from_dict(few), 1e-3)
assert alone.search.start.benchmark.ranks.size == 1 if MPI.COMM_WORLD.Get_rank() == 0 else alone is None
if MPI.COMM_WORLD.Get_rank() == 0:
    (folder / f"{MPI.COMM_WORLD.Get_size()}.json").write_text(json.dumps(found))
