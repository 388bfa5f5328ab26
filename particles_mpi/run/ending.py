"""The end of a run: prints the phase table, remarks and where to look next, and writes `run.json`."""

import json
import platform
import sys
from importlib.metadata import version
from pathlib import Path
from shlex import quote
from typing import Any

from particles_mpi.contacts.drift import COUNTS
from particles_mpi.measure.energy_change import Energies
from particles_mpi.output.files import write_text
from particles_mpi.parallel.communicator import mpi_library
from particles_mpi.run.console import PHASES, Screen

PROJECT = Path(__file__).parents[2]  # where run.sh and python_viz are, unless only the package was installed


def as_typed(path: Path) -> str:
    """Return a path as a user would type it in this folder."""
    try:
        return quote(str(path.relative_to(Path.cwd())))
    except ValueError:
        return quote(str(path))


if Path("run.sh").is_file():
    PROGRAM = "./run.sh"  # as a user would start it here
elif (PROJECT / "run.sh").is_file():
    PROGRAM = as_typed(PROJECT / "run.sh")
else:
    PROGRAM = "particles-mpi"
LIBRARIES = ("numpy", "numba", "mpi4py", "h5py", "meshio", "particles-mpi")


def report_end(
    sim: Any, plan: dict[str, Any], folder: Path, screen: Screen, seconds: dict[str, float], phases: dict[str, float],
    first: int, energies: Energies, ended: bool,
) -> None:  # fmt: skip
    """Print the phase table and the remarks of a run, and write `run.json` into its folder. Collective.

    `ended`: was its last step done, or was the run stopped? `seconds`: of this rank for the set-up and for the loop, which began
    with the step `first`; `phases`: for those of the loop. `energies`: of the rows of diagnostics.
    """
    timers, counts = phase_seconds(sim, seconds, phases), run_counts(sim)
    sim.output_record.energy_remarks = energies.remarks(sim.active)
    remarks = sim.remarks()
    screen.phases(timers, sim.steps_done - first, sim.total)
    say = screen.say
    if windows := counts.get("windows"):
        redone = counts["windows_redone"]
        say(f"{windows} time windows verified between the ranks, {redone} computed again ({100 * redone / windows:.1f} %)")
    for remark in remarks:
        say(remark)
    outcome = {"ended": ended, "timed_from": first, "timers": timers, "phases": PHASES, "remarks": remarks}
    about = about_run(sim, plan) | outcome | {"counts": {"steps": sim.steps_done, **counts}}
    write_text(folder / "run.json", sim.ranks, json.dumps(about, indent=2) + "\n")
    formats, shown = sim.scene.output.formats, quote(str(folder))
    if sim.output_record.written["frame"] < 0:  # there is nothing to be seen
        return
    if formats:
        say(f"ParaView: paraview {quote(str(folder / 'view_paraview.py'))}", whole=True)
    if "vtk" in formats:
        from particles_mpi.output.vtk import suffix

        say(f"VisIt: {folder}/vtk/particles_*.{suffix(sim.ids)} database", whole=True)
    if "hdf5" in formats:
        say(f"view: {PROGRAM} view {shown}", whole=True)
        if (plots := PROJECT / "python_viz").is_dir():
            python, script = as_typed(Path(sys.executable)), as_typed(plots / "plot_frame.py")
            say(f"plots: {python} {script} {shown}   (and plot_diagnostics.py, plot_phases.py, animate.py)", whole=True)


def phase_seconds(sim: Any, seconds: dict[str, float], phases: dict[str, float]) -> dict[str, dict[str, float]]:
    """Least, mean and largest seconds among the ranks of the set-up, the loop, and each phase of it. Collective."""
    of_ranks = sim.ranks.allgather({**seconds, **phases, "other": seconds["loop"] - sum(phases.values())})
    result = {}
    for name in [*seconds, *sorted(set().union(*of_ranks) - seconds.keys())]:
        values = [one.get(name, 0.0) for one in of_ranks]
        result[name] = {"min": min(values), "mean": sum(values) / len(values), "max": max(values)}
    return result


def run_counts(sim: Any) -> dict[str, int]:
    """Sums over the ranks of what was sent, and of what happened. Collective."""
    here, ranks = sim.counted(), sim.ranks
    counted = {name: sim.totals[name] for name in COUNTS}
    counted |= {"messages": ranks.messages, "ghost_rows": here["ghost_rows"]}
    result = dict(zip(counted, ranks.total(*counted.values())))
    if here["windows"]:
        result |= {name: here[name] for name in ("windows", "windows_redone")}
    return result | {"reductions": ranks.reductions, "pair_searches": here["pair_searches"]}


def scene_and_folder(scene: Any) -> dict[str, Any]:
    """The scene, and the folder to which the files that it names are relative."""
    return {"scene": scene.to_dict(), "folder": str(scene.folder.resolve())}


def about_run(sim: Any, plan: dict[str, Any]) -> dict[str, Any]:
    """The scene, the length of a step, how often each effect of the plan was called, and the versions of all that took part."""
    calls = sim.calls
    effects = [row | {"calls": calls.get(row["effect"], 0)} for row in plan["effects"]]
    not_run = [{"effect": name, "calls": calls.get(name, 0)} for name in plan["not_run"]]
    return {
        **scene_and_folder(sim.scene),
        "h": sim.h,
        "plan": plan | {"effects": effects, "not_run": not_run},
        "ranks": sim.ranks.size,
        "versions": {n: version(n) for n in LIBRARIES} | {"python": platform.python_version(), "mpi": mpi_library()},
    }
