"""The study's machinery: timing by turns, orders, fronts, tables, a page that needs nothing else."""

import csv
import json
import re
from math import isnan

import pytest

from particles_mpi import Scene
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.run.console import Screen
from particles_mpi.study import plots, report
from particles_mpi.study.accuracy import command
from particles_mpi.study.experiment import Benchmark, Experiment, Row, Setting, observe_orders, slope
from particles_mpi.study.timing import Seconds, StepTimer, time_in_turns

ORDER = []


class Stepper:
    """Counts its steps, and those of all others."""

    def __init__(self, name):
        self.name, self.done = name, 0

    def steps(self, number):
        self.done += number
        ORDER.extend(number * [self.name])

    def work(self):
        return {"forces": 3 * self.done}


def rows_of(curve, errors, seconds):
    rows = []
    for k, (error, s) in enumerate(zip(errors, seconds, strict=True)):
        setting = Setting(curve, 2.0**-k, lambda: None, 10, lambda sim: {})
        work = {"forces": 10, "events": 0}
        rows.append(Row(setting, {"place": error, "calls": 0.0}, work, Seconds(s, 0.9 * s, 1.1 * s)))
    observe_orders(rows)
    return rows


@pytest.fixture
def found():
    rows = rows_of("second", [1e-1, 2.5e-2, 6.25e-3], [1.0, 2.0, 4.0])
    rows += rows_of("fourth", [2e-1, 2e-1 / 16, 2e-1 / 256], [2.5, 5.0, 10.0])
    return Experiment("X", "A <problem>", "step", {"place": "how far off", "calls": "of others"}, "exact", rows, (2.0,), 1e-9)


def test_settings_take_turns_and_begin_anew_off_the_clock():
    ORDER.clear()
    begun = {"a": 0, "b": 0}

    def begin(name):
        begun[name] += 1
        return Stepper(name)

    watches = [StepTimer(Communicator.alone(), lambda name=name: begin(name), 7) for name in "ab"]
    told = []
    time_in_turns(watches, samples=4, sample_seconds=1e-4, progress=lambda: told.append(1))
    assert len(told) == 2 * 5 and [len(w.samples) for w in watches] == [4, 4]
    turns = re.sub(r"(.)\1+", r"\1", "".join(ORDER))
    assert turns == "bababa"  # ba ab ba ab ba
    assert min(begun.values()) > 1  # a run is seven steps long
    assert watches[0].seconds.low <= watches[0].seconds.median <= watches[0].seconds.high


def test_by_forces_a_unit_is_an_evaluation(monkeypatch):
    clock = iter(range(10**6))
    monkeypatch.setattr("particles_mpi.study.timing.perf_counter", lambda: float(next(clock)))  # a second a look
    steps, forces = (StepTimer(Communicator.alone(), lambda: Stepper("a"), 100, by_forces) for by_forces in (False, True))
    assert steps.sample(0.5) == 1.0
    assert forces.sample(0.5) == pytest.approx(1.0 / 3.0)
    monkeypatch.setattr(Stepper, "work", lambda _: {"forces": 0})
    assert forces.sample(0.5) == 1.0  # without forces a step


def test_orders_slopes_and_front(found):
    assert isnan(found.rows[0].orders["place"])
    assert found.rows[1].orders["place"] == pytest.approx(2.0) and found.rows[5].orders["place"] == pytest.approx(4.0)
    assert slope(found.curve("fourth"), "place") == pytest.approx(4.0)
    assert [(r.setting.curve, r.seconds.median) for r in found.front()] == [
        ("second", 1.0), ("second", 2.0), ("second", 4.0), ("fourth", 10.0)
    ]  # fmt: skip


def test_what_ten_times_more_costs(found):
    assert report.tenfold(found, "second") == pytest.approx(10**0.5)
    assert report.tenfold(found, "fourth") == pytest.approx(10**0.25)


def test_what_is_not_known_has_no_table(monkeypatch, tmp_path, capsys):
    """All settings of a scene may have the same error."""
    rows = rows_of("second", [1e-15] * 3, [1.0, 2.0, 4.0])
    flat = Experiment("S", "flat", "step", {"place": "how far off", "calls": "of others"}, "exact", rows)
    monkeypatch.setattr(command.scene_accuracy, "experiments", lambda *_: [flat])
    command.study_accuracy(Scene(dimension=1, time={"step": 1.0, "steps": 1}, particles=[]), "", True, tmp_path)
    assert f"{report.TENFOLD} is not known: along no curve" in capsys.readouterr().out
    assert report.TENFOLD.capitalize() not in (tmp_path / "report.html").read_text()


def test_tables(found, tmp_path):
    columns = report.errors_table(found).columns
    assert [column.header for column in columns] == ["setting", "step", "place", "order", "calls", "order", "seconds", "forces"]
    assert list(columns[0].cells) == [row.setting.curve for row in found.rows]
    assert all(len(list(column.cells)) == len(found.rows) for column in columns)
    assert [report.number(x) for x in (0.0, 1.0, 20_000.0, 0.0123, 1.23e-7, float("nan"))] == [
        "0", "1", "20 000", "0.012", "1.2e-07", ""
    ]  # fmt: skip
    report.write_csv(tmp_path / "x.csv", report.csv_rows(found))
    with (tmp_path / "x.csv").open() as file:
        read = list(csv.DictReader(file))
    assert [float(line["place"]) for line in read] == [row.errors["place"] for row in found.rows]
    assert [line["on the front"] for line in read] == ["1", "1", "1", "0", "0", "1"]


@pytest.mark.parametrize("terminal", [True, False])
def test_no_number_of_a_table_is_cut(terminal, monkeypatch, capsys):
    """On a narrow terminal its lines are longer than that is wide."""
    monkeypatch.setattr("particles_mpi.run.console.watched", lambda: terminal)
    monkeypatch.setenv("COLUMNS", "60")
    screen, table = Screen(is_root=True, quiet=False), report.numbers_table("setting", *10 * ["seconds"])
    screen.console._force_terminal = terminal
    table.add_row("leapfrog", *10 * ["1.234e-04 ±10%"])
    screen.table(table)
    assert capsys.readouterr().out.count("1.234e-04 ±10%") == 10


def test_a_page_that_opens_offline(found, tmp_path):
    found.answers = ["twice as fast & right"]
    about = report.describe_machine(Communicator.alone()) | {"samples": 7, "least_seconds": 0.2, "seconds": 1.0}
    path = report.write_report(tmp_path / "there", "What accuracy costs", [found], about)
    text = path.read_text()
    assert "<svg" in text and "A &lt;problem&gt;" in text and "twice as fast &amp; right" in text
    assert not re.search(r"(src|href)\s*=\s*[\"'](?!#)|@import|url\((?!#)", text.replace("xlink:href", "href"))
    assert json.loads((path.parent / "study.json").read_text())["experiments"][0]["rows"][0]["errors"]["place"] == 0.1
    assert {p.name for p in path.parent.iterdir()} == {"report.html", "study.json", "X.csv", "X.svg"}


def test_plots_without_an_error(found):
    for row in found.rows:
        row.errors["place"] = 0.0
    assert plots.svg(found).startswith("<svg")


def test_a_benchmark_measures_errors_work_and_time():
    lab = Benchmark(samples=2, quick=True)
    tables_ = {"dimension": 1, "time": {"step": 0.5, "steps": 4}, "particles": [{"position": [[0.0]], "velocity": [[1.0]]}]}

    def errors(sim):
        sim.run()
        return {"place": abs(float(sim.particles.position[0, 0]) - 2.0)}

    setting = Setting("leapfrog", 0.5, lambda: lab.simulate(tables_), 4, errors)
    (row,) = lab.compare("X", "free flight", [setting], {"place": "how far off"}, "exact").rows
    assert row.errors == {"place": 0.0} and row.seconds.median > 0.0
    assert row.work == {"forces": 0, "interactions": 0, "pair_tests": 0, "events": 0}
