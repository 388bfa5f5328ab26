"""The time limit of the batch job, of Slurm, in which the program runs.

Sources: the manual pages of sbatch (SLURM_JOB_ID, SLURM_JOB_END_TIME) and squeue (%L, the time left).
"""

import os
from math import inf
from subprocess import DEVNULL, SubprocessError, check_output
from time import localtime, strftime, time

STOP_SECONDS, STOP_SHARE = 60.0, 0.01  # before the limit a run stops: seconds, or this share of the time left if that is longer,
LARGEST_SHARE = 0.25  # but at most this share of it
SQUEUE_SECONDS = 30.0  # seconds in which squeue has to answer


def slurm_limit() -> tuple[float | None, str]:
    """Seconds from now after which a run in a job of Slurm should stop, and a line that says so; (None, "") if there is no limit.

    Where the limit cannot be found out, the line tells why.
    """
    job = os.environ.get("SLURM_JOB_ID")
    if not job:
        return None, ""
    try:
        end = os.environ.get("SLURM_JOB_END_TIME")  # since the epoch; older versions of Slurm do not tell it
        command = ["squeue", "-h", "-j", job, "-o", "%L"]
        text = "" if end else check_output(command, stderr=DEVNULL, text=True, timeout=SQUEUE_SECONDS).strip()
        if text == "UNLIMITED":
            return None, ""
        left = float(end) - time() if end else parse_time(text)
    except (OSError, ValueError, SubprocessError) as error:
        return None, f"the time limit of job {job} is not known ({str(error).splitlines()[0]}): give --wall-time"
    margin = min(max(STOP_SECONDS, STOP_SHARE * left), LARGEST_SHARE * max(left, 0.0))
    stop = left - margin
    return stop, f"stops at {strftime('%H:%M:%S', localtime(time() + stop))}, {margin:.0f} s before the limit of job {job}"


def parse_time(text: str) -> float:
    """The seconds of a time [days-][[hours:]minutes:]seconds. Raises a ValueError for any other text."""
    days, dash, clock = text.rpartition("-")
    parts = [float(part) for part in (days if dash else "0", *clock.split(":"))]
    if len(parts) > 4 or not all(0.0 <= part < inf for part in parts):
        raise ValueError(f"{text!r} is not HH:MM:SS")
    return 86400.0 * parts[0] + sum(part * 60.0**k for k, part in enumerate(reversed(parts[1:])))
