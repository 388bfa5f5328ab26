"""`study accuracy` as users start it: the same errors on one rank and on two, files that others can read, exit codes."""

import csv
import json

import pytest
from conftest import run_ranks

from particles_mpi.study.accuracy import effects

pytestmark = pytest.mark.parallel


def study(ranks, *arguments):
    return run_ranks(ranks, "-m", "particles_mpi", "study", *arguments, timeout=280)


KEYS = {"C": ["C2"], "G": ["G1", "G2", "G3", "G4"], "H": ["H"]}


@pytest.fixture(scope="module")
def only(request):
    """The letters of the experiments: effects, and with --all fluid and losses too."""
    return "CGH" if request.config.getoption("--all") else "H"


@pytest.fixture(scope="module")
def reports(tmp_path_factory, only):
    """Folders of a quick study on one rank and on two."""
    folders = {}
    for ranks in (1, 2):
        folders[ranks] = tmp_path_factory.mktemp(f"on{ranks}") / "study"
        done = study(ranks, "accuracy", "--quick", "--only", only, "--output", folders[ranks])
        assert done.returncode == 0, done.stderr
        assert "what ten times more accuracy costs" in done.stdout and "report.html" in done.stdout
    return folders


def test_errors_are_the_same_on_any_number_of_ranks(reports, only):
    told = {ranks: json.loads((folder / "study.json").read_text())["experiments"] for ranks, folder in reports.items()}
    assert [e["key"] for e in told[1]] == [key for letter in only for key in KEYS[letter]]
    for one, two in zip(told[1], told[2], strict=True):
        for a, b in zip(one["rows"], two["rows"], strict=True):
            if one["key"] == "H":  # messages are between ranks
                a["errors"].pop("messages"), b["errors"].pop("messages")
            assert (a["setting"], a["parameter"], a["errors"]) == (b["setting"], b["parameter"], b["errors"])


def test_an_effect_alone_sends_nothing(reports):
    one, two = (json.loads((reports[r] / "study.json").read_text())["experiments"][-1]["rows"] for r in (1, 2))
    assert all(row["errors"] == {"calls": 0.0, "messages": 0.0, "bits": 0.0} for row in one)
    assert all(row["errors"]["calls"] == 0 == row["errors"]["bits"] for row in two)
    sent = {row["setting"]: row["errors"]["messages"] for row in two}
    assert {name for name, count in sent.items() if count} <= {"collisions", "all but user_acceleration", "all of these"}


def test_files(reports, only):
    together = {"nothing", "all but user_acceleration", "all of these"}
    settings = {"C2": {"event", "rewind, 10 passes", "rewind, 1 pass"}, "H": together | effects.ACTIVE.keys()}
    for key in settings if "C" in only else ["H"]:
        with (reports[2] / f"{key}.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert {row["setting"] for row in rows} == settings[key]
        assert all(float(row["first quartile"]) <= float(row["seconds"]) <= float(row["third quartile"]) for row in rows)
    page = (reports[2] / "report.html").read_text()
    assert page.count("<svg") == sum(len(KEYS[letter]) for letter in only)
    for names in ("www.w3.org", "purl.org", "creativecommons.org"):  # of what SVG means, not to be loaded
        page = page.replace(f"http://{names}", "")
    assert "http://" not in page


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("accuracy", "--only", "AX"), "--only: there is no experiment X; there are A, B, C, D, F, G, H, I"),
        (("accuracy", "none.toml"), "none.toml: cannot be read"),
        (("none.toml",), "none.toml: cannot be read"),
        (("nothing",), "nothing"),
    ],
)
def test_faults(arguments, line, tmp_path):
    """Each is found before anything is written."""
    done = study(1, *arguments, *(["--output", tmp_path / "o"] if "AX" in arguments else []))
    assert not (tmp_path / "o").exists()
    assert done.returncode == 2 and line in done.stderr and "Traceback" not in done.stderr
