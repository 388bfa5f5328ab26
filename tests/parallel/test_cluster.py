"""As on a cluster: ranks that share nothing but the folder of the run, and jobs that go on where the one before was stopped."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time

import killing
import pytest
from conftest import ROOT, run_ranks
from killing import contents, final_state
from numba.core.caching import _CacheLocator

from particles_mpi import Run
from particles_mpi.setup.kernel_sources import PACKAGE

pytestmark = pytest.mark.parallel
RARELY = "every = 20\ncheckpoint_every = 1000"
EVENT = killing.SCENE.replace("every = 2\ncheckpoint_every = 3", RARELY).replace("steps = 400", "steps = 100")
REWIND = EVENT.replace('mode = "event"', "").replace("contact_duration = 1e-3", "")


@pytest.fixture(scope="module")
def apart(tmp_path_factory):
    """A folder with one folder for each of three ranks: its own compiled kernels, its own temporary files."""
    folder = tmp_path_factory.mktemp("apart")
    for rank in range(3):
        (folder / str(rank) / "tmp").mkdir(parents=True)
        for cache in PACKAGE.rglob("__pycache__"):
            own = folder / str(rank) / "kernels" / _CacheLocator.get_suitable_cache_subpath(cache.parent / "module.py")
            shutil.copytree(cache, own, ignore=shutil.ignore_patterns("*.pyc", "*.json"), copy_function=os.symlink)
    return folder


@pytest.fixture
def job(apart, tmp_path):
    """Starts the program as run.sh does in a job of Slurm, whose srun is tests/parallel/srun; not waited for."""
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "srun").symlink_to(ROOT / "tests" / "parallel" / "srun")
    launch = re.search(r"^launch\(\) \{.*?^\}", (ROOT / "run.sh").read_text(), re.DOTALL | re.MULTILINE)[0]

    def start(*arguments, seconds_left=3600, **slurm):
        environment = killing.environment() | {"APART": str(apart)}
        environment |= {"PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}", "SLURM_JOB_ID": "7"}
        environment |= {"SLURM_JOB_END_TIME": str(int(time.time() + seconds_left))} | slurm
        command = ["bash", "-c", launch + '\nlaunch "$@"', "bash", sys.executable, "-m", "particles_mpi", *map(str, arguments)]
        pipe = subprocess.PIPE
        return subprocess.Popen(command, cwd=ROOT, env=environment, stdout=pipe, stderr=pipe, text=True)

    return start


def program(ranks, *arguments):
    return run_ranks(ranks, "-m", "particles_mpi", "run", *arguments)


def test_a_chain_of_jobs_has_the_bits_of_one_run(job, apart, tmp_path):
    scene, other, out = tmp_path / "scene.toml", tmp_path / "other.toml", tmp_path / "o"
    scene.write_text(EVENT)
    other.write_text(EVENT.replace("seed = 5", "seed = 6"))
    assert program(1, scene, "--output", tmp_path / "whole", "--quiet").returncode == 0
    assert program(1, scene, "--output", out, "--steps", 5, "--quiet").returncode == 0
    (out / "checkpoint.h5").unlink()  # as if it had been killed before its first checkpoint
    begun = (out / "run.json").stat().st_mtime_ns
    done = program(2, other, "--output", out, "--resume", "auto")
    assert done.returncode == 2 and "seed: differs from" in done.stderr and (out / "run.json").stat().st_mtime_ns == begun

    first = job("run", scene, "--output", out, "--resume", "auto", SLURM_NTASKS="2")
    while (out / "run.json").stat().st_mtime_ns == begun:  # until the run takes the folder
        assert first.poll() is None, first.communicate()
        time.sleep(0.005)
    first.send_signal(signal.SIGUSR1)
    said, told = first.communicate(timeout=100)
    assert first.returncode == 130 and "continue with --resume" in told, told
    assert re.search(r"stops at \d\d:\d\d:\d\d, (7[12]|60) s before the limit of job 7", said), said
    step = final_state(out)[2]
    assert 0 <= step < 100

    second = job("run", scene, "--output", out, "--resume", "auto", seconds_left=0, RANKS="3", SLURM_NTASKS="2")
    said, told = second.communicate(timeout=100)
    assert second.returncode == 130 and f"continues from step {step}" in said and f"stopped at step {step} " in told, told

    third = job("run", scene, "--output", out, "--resume", "auto", "--quiet", SLURM_NTASKS="3")
    told = third.communicate(timeout=100)[1]
    assert third.returncode == 0, told
    calls = (apart / "told").read_text().splitlines()
    assert [re.search(r"--mpi=pmi(?:x|2) .*-n (\d)", call)[1] for call in calls] == ["2", "3", "3"]
    assert contents(out) == contents(tmp_path / "whole") and final_state(out) == final_state(tmp_path / "whole")
    ended = (out / "checkpoint.h5").stat().st_mtime_ns, (out / "run.json").stat().st_mtime_ns
    done = program(2, scene, "--output", out, "--resume", "auto")
    assert done.returncode == 0 and "step 100 of 100: nothing is left to do" in done.stdout, done.stderr
    assert ended == ((out / "checkpoint.h5").stat().st_mtime_ns, (out / "run.json").stat().st_mtime_ns)

    about = json.loads((out / "run.json").read_text())
    (out / "run.json").write_text(json.dumps({"scene": about["scene"], "plan": about["plan"]}))  # killed before it told its end
    done = program(2, scene, "--output", out, "--resume", "auto", "--quiet")
    assert done.returncode == 0 and Run(out).ended, done.stderr
    assert contents(out) == contents(tmp_path / "whole") and final_state(out) == final_state(tmp_path / "whole")


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [2, 3])
def test_mode_rewind_on_ranks_that_share_nothing_but_the_output(job, tmp_path, ranks):
    scene, out, whole = tmp_path / "scene.toml", tmp_path / "o", tmp_path / "whole"
    scene.write_text(REWIND)
    assert program(1, scene, "--output", whole, "--quiet").returncode == 0
    apart = job("run", scene, "--output", out, "--quiet", SLURM_NTASKS=str(ranks))
    told = apart.communicate(timeout=100)[1]
    assert apart.returncode == 0, told
    assert contents(out) == contents(whole) and final_state(out) == final_state(whole)
