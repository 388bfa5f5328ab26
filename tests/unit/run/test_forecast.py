"""How long a run is said to take: from its own steps, by one function for `run` and `check`, or a range with its reason.

No test here looks at a real clock: what a step costs is made up.
"""

import json
import re
from types import SimpleNamespace

import pytest
from conftest import ROOT
from hypothesis import given, settings
from hypothesis import strategies as st

from particles_mpi import Scene, Simulation
from particles_mpi.cli import check
from particles_mpi.run import forecast
from particles_mpi.run.forecast import MEASURED_SECONDS, TRUST, Forecaster, outlook
from particles_mpi.run.job import Job

LINE = re.compile(
    r"  predicted: (about [\d.]+ (s|min|h)|[\d.]+ (s|min|h) to [\d.]+ (s|min|h)) on 1 rank(?P<reason>: [a-z, ]+)?"
    r" \([\d.e-]+ ms a step, measured over \d+ steps?(; [\d.]+ s in all for output)?\)"
)
COST = st.floats(1e-5, 3.0)


def invented(monkeypatch, steps, every, step_costs, frame, row, saved, loading):
    """(forecasts, seconds at which they came, seconds of all) of a run whose costs are given.

    Its first row of diagnostics and its first step load kernels.
    """
    output = {"every": every[0], "diagnostics_every": every[1], "checkpoint_every": every[2]}
    scene = Scene(dimension=1, time={"step": 1.0, "steps": steps}, particles=[], output=output)
    clock, seconds = [0.0], {}
    loader = SimpleNamespace(done=True, duration=0.0)
    monkeypatch.setattr(forecast, "perf_counter", lambda: clock[0])
    monkeypatch.setattr(forecast, "LOADING", loader)
    sim = SimpleNamespace(scene=scene, steps_done=0, ranks=SimpleNamespace(size=1))

    def spend(cost, phase=None):
        clock[0] += cost
        if phase:
            seconds[phase] = seconds.get(phase, 0.0) + cost
        sim.timers = SimpleNamespace(seconds=dict(seconds))

    spend(0.0)
    pace = Forecaster(sim, steps)
    loader.duration += loading
    spend(loading + row, "diagnostics")
    pace.reported()
    spend(frame, "output")
    found = []
    for n in range(1, steps + 1):
        sim.steps_done = n
        spend(step_costs(n), "drift")
        if n in (1, 3):
            loader.duration += loading
            spend(loading, "drift")
        if n % every[1] == 0 or n == steps:
            spend(row, "diagnostics")
        if n % every[0] == 0:
            spend(frame, "output")
        if n % every[2] == 0 or n == steps:
            spend(saved, "checkpoint")
        if told := pace.due_forecast():
            found.append((told, clock[0], n))
    return found, clock[0]


@settings(max_examples=100)
@given(
    steps=st.integers(2, 400),
    every=st.tuples(st.integers(1, 500), st.integers(1, 500), st.integers(1, 500)),
    costs=st.tuples(COST, COST, COST),
    loading=st.floats(0.0, 20.0),
)
def test_steps_that_go_on_as_they_began_are_foretold_exactly(steps, every, costs, loading):
    """With frames, rows and checkpoints, however often; kernels loaded on the way count once, and not with every step."""
    with pytest.MonkeyPatch.context() as patch:
        step, frame, row = costs
        found, whole = invented(patch, steps, every, lambda n: step, frame, row, frame, loading)
    told, _, n = found[0]
    late = loading if n < 3 <= steps else 0.0  # not yet loaded then
    assert told.seconds == pytest.approx(whole - late, rel=1e-9)
    assert told.step == pytest.approx(step, rel=1e-9)
    assert told.least <= told.seconds <= told.most and not told.reason
    assert n <= max(2, steps // 2 + 1, n if step >= MEASURED_SECONDS else 0) and (n - 2) * step <= MEASURED_SECONDS + step


def test_what_turns_out_otherwise_is_told_anew(monkeypatch):
    """Steps that become twenty times as long: half way through, the last forecast is right to a factor of 1.5."""
    found, whole = invented(monkeypatch, 2000, (100, 10, 500), lambda n: 0.001 if n < 700 else 0.02, 0.01, 0.001, 0.01, 0.0)
    assert found[0][0].most < whole
    last = [told for told, when, _ in found if when < 0.5 * whole][-1]
    assert whole / TRUST <= last.seconds <= whole * TRUST and len(found) < 10


def test_a_first_step_that_serves_many_says_nothing_of_the_others(monkeypatch):
    """As that of ten million spheres: 7 s with the first search, then 0.3 s, and 2 s in every tenth, which searches anew."""
    cost = lambda n: 7.0 if n == 1 else 2.0 if n % 10 == 1 else 0.3  # noqa: E731
    found, whole = invented(monkeypatch, 100, (50, 10, 50), cost, 3.0, 0.5, 4.0, 0.1)
    assert all(whole / TRUST <= told.seconds <= whole * TRUST for told, _, _ in found)
    assert found[0][1] < 25.0


FALLING = ("marbles", "bounce", "rubble_pile", "silo", "hourglass", "break_shot")


def test_scenes_that_may_take_longer_say_why():
    """Of those that come with the program: where forces meet contacts, or steps are cut by bodies that come close."""
    reasons = {path.stem: outlook(Scene.load(path)) for path in (ROOT / "particles_mpi" / "scenes").glob("*.toml")}
    assert {name for name, seen in reasons.items() if seen.reason} == {*FALLING, "pythagorean"}
    assert all((seen.most > TRUST) == bool(seen.reason) for seen in reasons.values())
    assert all("contacts" in reasons[name].reason for name in FALLING)


SCENE = """
dimension = 2
[box]
lower = [0, 0]
upper = [4, 4]
[time]
step = 0.01
steps = 60
[[particles]]
count = 20
position = "random"
velocity = {speed = 0.5}
radius = 0.1
[effects.collisions]
restitution = 0.5
[effects.walls]
[output]
every = 10
"""
GRAVITY = "[effects.uniform_gravity]\nacceleration = [0, -1]\n"


@pytest.mark.parametrize("falls", [True, False])
def test_check_and_run_tell_it_alike(falls, tmp_path, monkeypatch, capsys):
    """The same line by the same function; `check` leaves nothing behind, and `run` writes it into run.json."""
    (tmp_path / "scene.toml").write_text(SCENE + GRAVITY * falls)
    monkeypatch.chdir(tmp_path)
    check(tmp_path / "scene.toml")
    checked = capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["scene.toml"]
    Job(Simulation(Scene.load(tmp_path / "scene.toml")), tmp_path / "o").run()
    ran = capsys.readouterr().out
    reasons = [LINE.search(said)["reason"] for said in (checked, ran)]
    assert reasons[0] == reasons[1] and bool(reasons[0]) == falls
    assert checked.count("predicted: ") == ran.count("predicted: ") == 1 and "ns a particle-step" not in checked
    plan = json.loads((tmp_path / "o" / "run.json").read_text())["plan"]
    assert plan["predicted_seconds_range"][0] <= plan["predicted_seconds"] <= plan["predicted_seconds_range"][1]


def test_a_quiet_run_does_not_predict_and_both_do_the_same_work(tmp_path, capsys):
    (tmp_path / "scene.toml").write_text(SCENE + GRAVITY)
    told = []
    for quiet in (True, False):
        job = Job(Simulation(Scene.load(tmp_path / "scene.toml")), tmp_path / "o", quiet=quiet, overwrite=True)
        job.run()
        told.append(json.loads((tmp_path / "o" / "run.json").read_text()))
        assert (job.forecast is None) == quiet
    assert told[0]["counts"] == told[1]["counts"]
    assert [effect["calls"] for effect in told[0]["plan"]["effects"]] == [
        effect["calls"] for effect in told[1]["plan"]["effects"]
    ]
    assert told[0]["plan"]["predicted_seconds"] is None
