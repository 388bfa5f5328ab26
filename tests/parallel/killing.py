"""Runs that are killed, and what must be left of them. `python tests/parallel/killing.py 100` does it a hundred times."""

import contextlib
import csv
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py

sys.path.insert(0, str(Path(__file__).parents[1]))
from ranks import ROOT, environment

from particles_mpi import Run
from particles_mpi.output import checkpoint
from particles_mpi.parallel.launcher import runs

SCENE = """
dimension = 2
seed = 5
[box]
lower = [0, 0]
upper = [4, 4]
[time]
step = 0.01
steps = 400
[[particles]]
count = 40
position = "random"
velocity = {speed = 2.0}
radius = 0.1
mass = {min = 0.1, max = 0.5}
[effects.collisions]
mode = "event"
restitution = 0.9
contact_duration = 1e-3
[effects.walls]
restitution = 0.9
[effects.uniform_gravity]
acceleration = [0, -9.81]
[effects.drag]
rate = 0.1
[output]
every = 2
checkpoint_every = 3
diagnostics_every = 1
observables = true
"""


def start(ranks, *arguments):
    """The program on some ranks, not waited for."""
    command = ["mpirun", "-n", ranks, sys.executable, "-m", "particles_mpi", *arguments]
    pipe = subprocess.PIPE
    return subprocess.Popen(list(map(str, command)), cwd=ROOT, env=environment(), stdout=pipe, stderr=pipe, text=True)


def ranks_of(launcher):
    """Process ids of the ranks: the children of mpirun, which is the child of the process that looks after it."""
    return [rank for mpirun in children(launcher.pid) for rank in children(mpirun)]


def children(pid):
    """Process ids of the children of a process."""
    lists = [path.read_text().split() for path in Path(f"/proc/{pid}/task").glob("*/children")]
    return [int(child) for pids in lists for child in pids]


def finish(launcher):
    """What it says on stderr until it ends; a hang is a failure, and leaves nobody behind."""
    try:
        return launcher.communicate(timeout=100)[1]
    except subprocess.TimeoutExpired:
        kill(launcher)
        raise


def kill(launcher):
    """-9, at once and all of them."""
    for pid in children(launcher.pid):
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGSTOP)  # so that it starts no more
    ranks = ranks_of(launcher)
    for pid in [*ranks, *children(launcher.pid), launcher.pid]:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    launcher.communicate()
    while any(runs(str(rank)) for rank in ranks):  # one that waits for the disk holds the folder until then
        time.sleep(0.001)


def kill_one(launcher, rank, folder):
    """-9 to one rank: mpirun must end the others, and say so, unless the run in the folder has come to its end just now."""
    ranks = ranks_of(launcher)
    if launcher.poll() is not None or not ranks:
        return kill(launcher)
    with contextlib.suppress(ProcessLookupError):  # it ended by itself just now
        os.kill(ranks[rank % len(ranks)], signal.SIGKILL)
        finish(launcher)
        assert launcher.returncode != 0 or Run(folder).ended


def contents(folder):
    """All that a run has written and that must not depend on how it came there; frames as a list of bytes."""
    with h5py.File(folder / "trajectory.vtkhdf", locking=False) as file:
        group = file["VTKHDF"]
        count, total = int(group["Steps"].attrs["NSteps"]), int(group["NumberOfPoints"][0])
        names = ["Points", *(f"PointData/{name}" for name in sorted(group["PointData"]))]
        frames = [
            (float(group["Steps/Values"][k]), *(group[name][k * total : (k + 1) * total].tobytes() for name in names))
            for k in range(count)
        ]
    lines = (folder / "diagnostics.csv").read_text().splitlines(keepends=True)
    table = list(csv.reader(line for line in lines if line.endswith("\n")))
    kept = [k for k, name in enumerate(table[0]) if name not in ("exchanges", "imbalance")]  # those tell of ranks
    listing = [line for line in (folder / "particles.pvd").read_text().splitlines() if "timestep" in line]
    series = [(line, (folder / line.split('"')[5]).read_bytes()) for line in listing]
    return {"frames": frames, "rows": [[row[k] for k in kept] for row in table], "series": series}


def final_state(folder):
    """Of its last checkpoint."""
    file = checkpoint.Checkpoint(folder / "checkpoint.h5")
    contacts, about = file.contacts(0, file.number_of_contacts), file.attributes
    rows = {name: array.tobytes() for name, array in file.rows(0, file.total).items()}
    return rows, [column.tobytes() for column in contacts], about["step"], about["time"], about["observed"]


def check_killed(folder, whole):
    """Whatever is there can be read, and is the beginning of the whole run. Returns the step of the checkpoint, if any."""
    if (folder / "particles.pvd").exists():  # there since the first frame
        found = contents(folder)
        for name, entries in found.items():
            assert entries == whole[name][: len(entries)], name
    if not (folder / "checkpoint.h5").exists():
        return None
    step = checkpoint.Checkpoint(folder / "checkpoint.h5").attributes["step"]
    assert len(found["frames"]) > step // 2 and len(found["rows"]) > step + 1
    return step


def inode(path):
    """Changes when a file is replaced."""
    return path.stat().st_ino if path.exists() else 0


def kill_and_resume(folder, scene, whole, kills, chance):
    """A run to its end through so many kills; returns the steps at which it went on."""
    steps = []
    for number in range(kills + 1):
        step = check_killed(folder, whole) if folder.exists() else None
        steps.append(step)
        way = ["--overwrite"] if step is None else ["--resume", folder / "checkpoint.h5"]
        before = {name: inode(folder / name) for name in ("diagnostics.csv", "checkpoint.h5")}
        launcher = start(chance.choice([1, 2]), "run", scene, "--output", folder, *way, "--quiet")
        if number == kills:
            told = finish(launcher)
            assert launcher.returncode == 0, told
            return steps
        # in the set-up; while files are made or cut, and the first steps; amid frames and checkpoints
        name, patience = chance.choice([(None, 3.0), ("diagnostics.csv", 0.3), ("checkpoint.h5", 0.6), ("checkpoint.h5", 0.6)])
        while name and launcher.poll() is None and inode(folder / name) == before[name]:
            time.sleep(0.001)
        time.sleep(chance.uniform(0.0, patience))
        if chance.random() < 0.5:
            kill(launcher)
        else:
            kill_one(launcher, chance.randrange(2), folder)
    return steps


def main():
    wanted, done, chance = int(sys.argv[1]), 0, random.Random(int(sys.argv[2]))
    with tempfile.TemporaryDirectory() as name:
        scene, whole = Path(name) / "scene.toml", Path(name) / "whole"
        scene.write_text(SCENE)
        assert start(1, "run", scene, "--output", whole).wait() == 0
        expected = contents(whole)
        while done < wanted:
            folder = Path(name) / str(done)
            steps = kill_and_resume(folder, scene, expected, 10, chance)
            assert contents(folder) == expected and final_state(folder) == final_state(whole)
            done += 10
            print(done, "kills, nothing lost; went on at", steps, flush=True)


if __name__ == "__main__":
    main()
