"""The substeps of the integrator `adaptive`, but for the evaluation of forces. Scalars and arrays only.

A substep is a collocation at its eight Gauss-Radau nodes, of order 15 (E. Everhart, in Dynamics of Comets, 1985; its length is
chosen as by H. Rein and D. S. Spiegel, MNRAS 446, 1424, 2015). The acceleration is a polynomial of the time. At the nodes it must
be equal to the acceleration at the positions to which the polynomial itself leads; iteration finds it. Its highest coefficient
over the largest acceleration, to the power 1/7, tells how long a substep may be.

Far from the origin, or where bodies are close, the rounding of coordinates limits the accuracy of accelerations, and no substep
is short enough to make the coefficient small (D. Pham, H. Rein, D. S. Spiegel, Open J. Astrophys. 7, 2024, show how substeps then
shrink for ever). So this round-off is measured at the start of each substep, by one more evaluation of forces at positions that
are moved by their own round-off. Iteration ends when changes are below it, and the tolerance is never below what it does to the
highest coefficient. Positions carry their round-off along (Kahan's sum). Nothing but the state is kept from one step of the scene
to the next, so a resumed run has the same bits.

`go_on` does all of this. Whenever it needs forces, it sets positions and returns. So forces may come from all ranks
(`gauss_radau`), or from within one compiled loop (`compiled_steps`), and everything else is the same.
"""

from typing import NamedTuple

import numpy as np

from particles_mpi.integrators.radau_tables import NODES
from particles_mpi.integrators.shaking import SHAKEN, shake
from particles_mpi.kernels.jit import in_place, lean_in_place
from particles_mpi.particles import Array

MOST_ITERATIONS = 12
SUM_ROUND_OFF = float(np.finfo(float).eps)  # round-off of a sum of forces, relative to the largest acceleration
CAUTION = 10.0  # times the change that the next iteration is expected to make
NOISY = 8.0  # times the round-off: changes from one iteration to the next that are nothing else
STALLED, DIVERGED = 1e-10, 1e-8  # of the largest acceleration: changes that need not shrink any more, and that must
SAFE_GROWTH = 0.25  # a substep is taken if the next one may be so many times as long, or longer
SHRINK, GROW = 0.1, 4.0  # bounds of the length of a substep, divided by that of the one before
SHORTEST = 1e-11  # of the longest substep so far in a step of the scene: where masses meet head on there is no end to it
BLIND = 4.0  # times the largest tolerance: more round-off hides the motion
MOST_BLIND = 100  # tries in a row in which it does; then it is an error
NOTHING = 1e-280  # smaller accelerations are none: times a tolerance they would leave the range of numbers
GUESSED = 1.5  # times the last step: for longer ones its polynomial is no guess
ROOT_ROUNDS = 60

# What `go_on` returns: what it needs, or how the step has ended.
FORCES, MAXIMA, END, STUCK = 0, 1, 2, 3
# The stage between two calls: what it needs next.
AT_START, SHAKEN_PLACES, AT_NODE, OVER_RANKS = 0, 1, 2, 3


PROGRESS = np.dtype(
    [(name, np.int64) for name in ("stage", "node", "iterations", "tries", "blind", "substeps", "guessable")]
    + [(name, np.float64) for name in ("step", "done", "length", "noise", "change", "before", "largest", "top")]
    + [(name, np.float64) for name in ("last_length", "last_begin", "longest")]
)


class Work(NamedTuple):
    """What a step of `adaptive` knows between two evaluations of the forces; vectors of all rows are flat, (n d,).

    progress (1,) of PROGRESS: stage, node and iterations of the substep of this `length`; tries so far, those in a row that
    were `blind`, and `substeps` taken; `done` of the `step`; noise: round-off of an acceleration; change, before: of this
    iteration and the one before; largest acceleration and `top`, the largest highest coefficient; of the last substep its
    length, where within it the next one begins (0 or 1), and whether it is `guessable`; the `longest` substep taken. x0:
    places at the start; lost: what rounding took from them; at (8, n d): accelerations at the nodes; last (8, n d): those of
    the last substep; row (8,): numbers of one component.
    """

    progress: Array
    x0: Array
    lost: Array
    at: Array
    last: Array
    row: Array


def work_for(numbers: int) -> Work:
    """Return empty `Work` for vectors that have so many numbers in all, n d."""
    none = np.zeros(numbers)
    return Work(np.zeros(1, PROGRESS), none, none.copy(), np.zeros((NODES, numbers)), np.zeros((NODES, numbers)), np.zeros(NODES))


# --- a substep, between two evaluations of the forces -----------------------------------------------------------------


@in_place
def copy(source, target):
    """target = source, both (m,)."""
    for m in range(len(source)):
        target[m] = source[m]


@in_place
def combine(weights, at, m):
    """sum_j weights[j] at[j, m], in this order."""
    total = weights[0] * at[0, m]
    for j in range(1, NODES):
        total += weights[j] * at[j, m]
    return total


@lean_in_place
def add(total, lost, change, m):
    """total[m] + lost[m] += change; total is rounded, and lost is what that took away (D. E. Knuth, TAOCP 2, 4.2.2)."""
    change += lost[m]
    rounded = total[m] + change
    part = rounded - total[m]
    lost[m] = (total[m] - (rounded - part)) + (change - part)
    total[m] = rounded


@in_place
def seventh_root(number):
    """The seventh root of a number of [SHRINK^7, GROW^7], by Newton's method: unlike a power, the same bits everywhere."""
    root = GROW
    for _ in range(ROOT_ROUNDS):
        power = root * root * root
        power *= power
        lower = root - (root * power - number) / (7.0 * power)
        if not lower < root:
            break
        root = lower
    return root


@in_place
def larger(one, other):
    """The larger of two numbers, and NaN if one is not a number."""
    return other if other > one or other != other else one


@in_place
def place(x, v, work, tables):
    """Set the positions x to those at the present node, by the accelerations known so far."""
    progress, x0, lost, at, _, _ = work
    s = progress[0]
    h, node = s["length"], s["node"]
    for m in range(len(x)):
        x[m] = x0[m] + (lost[m] + (h * tables.c[node] * v[m] + h * h * combine(tables.twice[node], at, m)))


@in_place
def guess(a, work, tables):
    """Guess accelerations at the nodes of a substep that begins with a: by the last polynomial, if it is not too short."""
    progress, _, _, at, last, row = work
    s = progress[0]
    known = s["guessable"] and not s["length"] > GUESSED * s["last_length"]
    for i in range(NODES):
        if known and i > 0:
            moment = s["last_begin"] + tables.c[i] * (s["length"] / s["last_length"])
            for j in range(NODES):
                row[j] = 0.0
                for power in range(NODES - 1, -1, -1):
                    row[j] = row[j] * moment + tables.lagrange[j, power]
        for m in range(len(a)):
            at[i, m] = combine(row, last, m) if known and i > 0 else a[m]


@in_place
def next_try(work, x):
    """Begin a substep of at most `length` at the positions that were reached."""
    progress, x0, _, _, _, _ = work
    s = progress[0]
    left = s["step"] - s["done"]
    s["length"] = left if s["length"] >= left else min(s["length"], 0.5 * left)  # no tiny last substep
    copy(x, x0)
    s["stage"] = AT_START


@in_place
def first_iteration(s):
    """Prepare an iteration, which begins at the first node after the start of the substep."""
    s["node"], s["before"], s["change"], s["largest"] = 1, s["change"], 0.0, 0.0


@in_place
def still_to_come(change, before):
    """Estimate, with caution, how much the next iteration would change, if changes shrink again as from `before` to `change`."""
    return min(change, CAUTION * change * (change / before)) if before < np.inf else change


@in_place
def end_of_try(x, v, round_off, left, work, tables):
    """Take the substep, or refuse it; returns how long the next one may be.

    It is refused if that is less than SAFE_GROWTH of this one: then x is x0 again, and v as it was.
    """
    progress, x0, lost, at, last, _ = work
    s = progress[0]
    h, largest = s["length"], s["largest"]
    copy(x0, x)
    s["blind"] = s["blind"] + 1 if tables.gain * round_off > BLIND * tables.coarsest * largest else 0
    least = min(tables.gain * round_off, tables.coarsest * largest)  # value of the highest coefficient that means something
    diverged = left > max(DIVERGED * largest, NOISY * least / tables.gain) and not largest <= NOTHING
    if diverged or not s["change"] < np.inf:  # far too long
        return SHRINK * h
    factor = GROW
    if not s["top"] <= NOTHING:
        ratio = max(tables.tolerance * largest, least) / s["top"]
        factor = seventh_root(min(max(ratio, SHRINK**7), GROW**7)) if ratio == ratio else np.nan
    s["last_length"], s["last_begin"], s["guessable"] = h, 1.0 if factor >= SAFE_GROWTH else 0.0, 1
    for i in range(NODES):
        copy(at[i], last[i])
    if factor >= SAFE_GROWTH:
        for m in range(len(x)):
            add(x, lost, h * v[m] + h * h * combine(tables.twice_end, at, m), m)
            v[m] += h * combine(tables.once_end, at, m)
    return h * factor


@lean_in_place
def begin(x, step, work):
    """Begin a step of the scene at the positions x. `go_on` must then be called with the forces there."""
    progress, _, lost, _, _, _ = work
    s = progress[0]
    s["step"] = s["length"] = step
    s["done"] = s["longest"] = 0.0
    s["tries"] = s["blind"] = s["guessable"] = 0
    for m in range(len(lost)):
        lost[m] = 0.0
    next_try(work, x)


@lean_in_place
def go_on(x, v, d, force, work, tables):
    """Continue the step until something is needed from outside. Returns what is needed, which must be ready at the next call.

    FORCES: `force` must be the accelerations at x. MAXIMA: noise, change, largest and top in `work.progress` must be the largest
    ones of all ranks. END: the step is done. STUCK: the next substep would be too short, or round-off hides the motion. x, v,
    force: vectors of all rows, flat (n d,). d: the dimension.
    """
    progress, _, _, at, _, _ = work
    s = progress[0]
    if s["stage"] == AT_START:
        copy(force, at[0])
        shake(x, d, s["tries"])
        s["stage"] = SHAKEN_PLACES
        return FORCES
    if s["stage"] == SHAKEN_PLACES:
        s["noise"] = 0.0
        for m in range(len(x)):
            s["noise"] = larger(s["noise"], abs(force[m] - at[0, m]) / SHAKEN)
        guess(at[0], work, tables)
        s["iterations"], s["change"], s["stage"] = 0, np.inf, AT_NODE
        first_iteration(s)
        place(x, v, work, tables)
        return FORCES
    if s["stage"] == AT_NODE:
        node = s["node"]
        for m in range(len(x)):
            if abs(force[m] - at[node, m]) > s["change"]:
                s["change"] = abs(force[m] - at[node, m])
            if abs(force[m]) > s["largest"]:
                s["largest"] = abs(force[m])
            at[node, m] = force[m]
        s["node"] += 1
        if s["node"] < NODES:
            place(x, v, work, tables)
            return FORCES
        s["top"] = 0.0
        for m in range(len(x)):
            s["top"] = larger(s["top"], abs(combine(tables.highest, at, m)))
        s["stage"] = OVER_RANKS
        return MAXIMA
    s["iterations"] += 1
    round_off, left = s["noise"] + SUM_ROUND_OFF * s["largest"], still_to_come(s["change"], s["before"])
    good = not left > round_off
    stalled = s["change"] >= s["before"] and s["change"] < max(STALLED * s["largest"], NOISY * round_off)
    if not (good or stalled) and s["iterations"] < MOST_ITERATIONS:
        first_iteration(s)
        place(x, v, work, tables)
        s["stage"] = AT_NODE
        return FORCES
    length, next_length = s["length"], end_of_try(x, v, round_off, left, work, tables)
    s["tries"] += 1
    if next_length >= SAFE_GROWTH * length:
        s["done"] = s["step"] if length == s["step"] - s["done"] else s["done"] + length
        s["substeps"] += 1
        s["longest"] = max(s["longest"], length)
    s["length"] = next_length
    if s["done"] >= s["step"]:
        return END
    if not next_length > SHORTEST * (s["longest"] if s["longest"] > 0.0 else s["step"]) or s["blind"] > MOST_BLIND:
        return STUCK
    next_try(work, x)
    return FORCES
