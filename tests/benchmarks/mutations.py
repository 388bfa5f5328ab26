"""Does the default suite notice a fault? Breaks a copy of the package on purpose, one place at a time, and runs the tests.

`python tests/benchmarks/mutations.py [NAME ...]`: all mutations, or those whose names contain one of the words. For each it runs
the tests that ought to notice, until the first that fails, and prints which one that is. Exit code 1 if a fault goes unnoticed.
A mutation of a compiled kernel takes a minute or two longer, for what calls the kernel is compiled again.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
COPIED = ("particles_mpi", "tests", "python_viz", "pyproject.toml", "README.md", "run.sh")


class Mutation(NamedTuple):
    """A fault: in `file` the text `old`, which must be there once, becomes `new`; `tests` are what pytest is given."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


CHANGE = "            return change\n    change = (1.0 + restitution) * approach\n    impulse = change / weight"
OTHER = "        v[j, column + k] = velocity_factor * (v[j, column + k] + impulse * w_j * r[k])\n"
MUTATIONS = (
    Mutation(
        "few spheres that collide go through one another",
        "contacts/clearance.py",
        "            if may_come_near(u2, ru, r2, radius[i] + radius[j], h):\n",
        "            if may_come_near(u2, ru, r2, 0.5 * (radius[i] + radius[j]), h):\n",
        ("tests/parallel/test_many_steps.py", "-k", "single_steps and 1"),
    ),
    Mutation(
        "few spheres keep a kick of a step that is done again",
        "integrators/compiled_steps.py",
        "                    copy_rows(begun, bodies.v)\n",
        "                    pass\n",
        ("tests/parallel/test_many_steps.py", "-k", "single_steps and 1"),
    ),
    Mutation(
        "neighbours are taken as known after steps that were computed at once",
        "neighbours/neighbour_list.py",
        "            self.candidates.time += drifts * h\n",
        "",
        ("tests/parallel/test_many_steps.py", "-k", "single_steps and 1"),
    ),
    Mutation(
        "ghosts are taken as known after steps that were computed at once",
        "neighbours/neighbour_list.py",
        "        if self.halo:\n            self.end_candidates()\n        elif",
        "        if",
        ("tests/parallel/test_many_steps.py", "-k", "single_steps and 2"),
    ),
    Mutation(
        "what contacts took is lost where rows change their rank",
        "contacts/persistent/memory.py",
        "    ours, _ = send(rows_of(strays, found), owner[place[found]])\n",
        "    ours, _ = send(rows_of(strays, found[:0]), owner[place[found[:0]]])\n",
        ("tests/parallel/test_same_bits.py", "-k", "same_bits and heap and -2"),
    ),
    Mutation(
        "sign of the restitution",
        "contacts/law.py",
        CHANGE,
        CHANGE.replace("1.0 + restitution", "1.0 - restitution"),
        ("tests/physics/test_time_stepped.py", "-k", "oblique"),
    ),
    Mutation(
        "the impulses of a pair are not opposite",
        "contacts/law.py",
        OTHER,
        OTHER.replace("impulse * w_j", "impulse * w_i"),
        ("tests/physics/test_time_stepped.py", "-k", "momentum"),
    ),
    Mutation(
        "ghosts are not refreshed",
        "parallel/halo.py",
        "            tables[table][ghosts] = place\n",
        "            pass\n",
        ("tests/parallel/test_same_bits.py", "-k", "marbles-2"),
    ),
    Mutation(
        "the opening angle is ignored",
        "gravity/tree.py",
        "Law(angle, softening2, quadrupoles)",
        "Law(1.0, softening2, quadrupoles)",
        ("tests/physics/test_tree.py",),
    ),
    Mutation(
        "a wrong weight of a kick in order4",
        "integrators/kicks_and_drifts.py",
        "B = (0.0829844064174052,",
        "B = (0.0839844064174052,",
        ("tests/physics/test_gravity.py",),
    ),
    Mutation(
        "half the rate of the drag",
        "effects/drag.py",
        "math.exp(-k * h)",
        "math.exp(-0.5 * k * h)",
        ("tests/physics/test_forces.py",),
    ),
    Mutation(
        "a checkpoint forgets which contacts last",
        "output/checkpoint.py",
        "    rows = in_id_order(ranks, arrays, ids, ranks.size)\n",
        "    arrays = arrays | {name: 0 * column for name, column in arrays.items() if name == 'supported'}\n"
        "    rows = in_id_order(ranks, arrays, ids, ranks.size)\n",
        ("tests/parallel/test_nothing_lost.py", "-k", "every_effect"),
    ),
    Mutation(
        "a checkpoint forgets the drag of each",
        "output/checkpoint.py",
        "    rows = in_id_order(ranks, arrays, ids, ranks.size)\n",
        "    arrays = arrays | {name: 0 * column for name, column in arrays.items() if name == 'drag'}\n"
        "    rows = in_id_order(ranks, arrays, ids, ranks.size)\n",
        ("tests/parallel/test_nothing_lost.py", "-k", "every_effect"),
    ),
    Mutation(
        "normals of oblique planes point the other way",
        "effects/walls.py",
        "        losses = [plane.within",
        "        normal[np.abs(normal).max(axis=1, initial=0.0) < 1.0] *= -1.0\n        losses = [plane.within",
        ("tests/physics/test_order_of_bounces.py", "tests/unit/initial"),
    ),
    Mutation(
        "sums go in the order of rows instead of that of ids",
        "parallel/exchange.py",
        'yield rows if (rows["id"][1:] > rows["id"][:-1]).all() else rows_of(rows, rows_in_order(rows["id"]))',
        "yield rows",
        ("tests/parallel/test_nothing_lost.py", "-k", "every_effect"),
    ),
    Mutation(
        "a window is never wrong",
        "contacts/event_driven/arrivals.py",
        "    return wrong, differing[:found]",
        "    return False, differing[:found]",
        ("tests/parallel/test_same_bits.py", "-k", "windows and -2"),
    ),
    Mutation(
        "a window is not wrong where owned rows were near a ghost, but not very near",
        "contacts/event_driven/regions.py",
        "within = regions.reach + radius",
        "within = 0.2 * regions.reach + radius",
        ("tests/unit/contacts", "tests/parallel/test_same_bits.py", "-k", "regions or (windows and -2)"),
    ),
    Mutation(
        "a window is not undone where somebody went further than ghosts reach",
        "contacts/event_driven/windows.py",
        "            if wrong or np.sqrt(fastest2) * length > part.regions.bound:",
        "            if wrong:",
        ("tests/parallel/test_same_bits.py", "-k", "lighter"),
    ),
    Mutation(
        "own rows are thought to touch ghosts only nearer to their region than they may",
        "contacts/event_driven/partition.py",
        "reach = (self.skin + 2.0 * bound + largest) * MARGIN",
        "reach = (0.3 * self.skin + largest) * MARGIN",
        ("tests/unit/contacts/test_regions.py",),
    ),
    Mutation(
        "at one time the order of rows decides who meets first",
        "contacts/event_driven/calendar_queue.py",
        "    return (repeated_i, min(a, b), max(a, b)) < (repeated_j, min(c, d), max(c, d))",
        "    return i < j",
        ("tests/physics/test_symmetries.py", "tests/parallel/test_same_bits.py", "-k", "symm or -2"),
    ),
    Mutation(
        "a heavy sphere stands still by what presses a light one onto it",
        "contacts/persistent/slow.py",
        "max(found[i], w[i] / (w[i] + w[partner[e]]) * larger_push[e])",
        "max(found[i], larger_push[e])",
        ("tests/hard_cases/test_rest.py", "-k", "pushes_a_heavy"),
    ),
    Mutation(
        "the closing kick gives nothing to the slip of rough spheres",
        "contacts/closing_kick.py",
        "            impulse -= grip[:, None] * (u - along[:, None] * normal)\n",
        "",
        ("tests/physics/test_closing_kick.py", "-k", "super"),
    ),
    Mutation(
        "the closing kick knows no periodic images",
        "contacts/closing_kick.py",
        "        r -= image_shifts(r, self.length)\n",
        "",
        ("tests/parallel/test_outside_effects.py", "-k", "face_of"),
    ),
    Mutation(
        "a try to end with a collision changes what contacts that last begin with",
        "between_steps/saved.py",
        "            sim.persistent.history.restore(self.contacts)\n        sim.drift",
        "            pass\n        sim.drift",
        ("tests/physics/test_to_collision.py", "-k", "no_trace"),
    ),
    Mutation(
        "no contact takes over from those on which it depends",
        "contacts/persistent/direct.py",
        "if not active.impulse[new] < inf:",
        "if active.impulse[new] > 0.0:",
        ("tests/hard_cases/test_very_different_masses.py",),
    ),
    Mutation(
        "the interval of observables is not in a checkpoint",
        "between_steps/saved.py",
        'since in metadata["observed"].items()}',
        "since in sim.output_record.observed.items()}",
        ("tests/parallel/test_nothing_lost.py", "-k", "every_effect"),
    ),
    Mutation(
        "places are not brought back into a periodic box",
        "contacts/drift.py",
        "                wrap(p.position, context.lower, context.upper, context.length)\n",
        "                pass\n",
        ("tests/physics/test_points.py", "-k", "periodic_box"),
    ),
    Mutation(
        "a step without collisions leaves what is known of neighbours",
        "contacts/drift.py",
        "            p.version += self.effects.pairs is not None  # what is known of neighbours does not hold any longer\n",
        "",
        ("tests/physics/test_random_scenes.py", "-k", "without_collisions"),
    ),
    Mutation(
        "flows of velocities move fixed particles",
        "integrators/kicks_and_drifts.py",
        "                particles.hold_fixed()\n",
        "                pass\n",
        ("tests/parallel/test_outside_effects.py", "-k", "moves_nobody"),
    ),
    Mutation(
        "flows of velocities are left out by the integrator adaptive",
        "scene/effect.py",
        "if name in cls.possible)",
        ")",
        ("tests/unit/scene/test_effects_of_users.py", "-k", "columns_only"),
    ),
    Mutation(
        "drag presses nobody onto another",
        "contacts/persistent/operator.py",
        "presses = (most",
        "presses = False and (most",
        ("tests/hard_cases/test_drag_of_what_lies.py", "-k", "sink"),
    ),
    Mutation(
        "walls that take no energy keep no pile",
        "contacts/persistent/operator.py",
        "keeping = taking | self.lossy ",
        "keeping = taking ",
        ("tests/hard_cases/test_rest.py", "-k", "touch_from"),
    ),
    Mutation(
        "several flows act in the same order before and after the force",
        "integrators/kicks_and_drifts.py",
        "            for name, flow in reversed(self.flows.items()):\n",
        "            for name, flow in self.flows.items():\n",
        ("tests/parallel/test_outside_effects.py", "-k", "two_flows"),
    ),
    Mutation(
        "a drift that throws a particle too far is not undone",
        "contacts/time_stepped/operator.py",
        "            self.undo()\n            if needed",
        "            if needed",
        ("tests/parallel/test_same_bits.py", "-k", "squeeze"),
    ),
    Mutation(
        "the virial of a drift that is undone stays",
        "contacts/time_stepped/operator.py",
        "        self.virial[:] = self.virial_before\n",
        "",
        ("tests/physics/test_time_stepped.py", "-k", "no_trace"),
    ),
    Mutation(
        "spins of a drift that is undone stay",
        "contacts/time_stepped/operator.py",
        "            near.spin[rows] = log.spin[:count]\n",
        "            pass\n",
        ("tests/physics/test_time_stepped.py", "-k", "no_trace"),
    ),
    Mutation(
        "the closing kick finishes bounces of what an event has moved since",
        "contacts/drift.py",
        "                self.closing.forget()  # places and velocities are not those of the contacts any longer\n",
        "                pass\n",
        ("tests/parallel/test_outside_effects.py", "-k", "not_finished"),
    ),
    Mutation(
        "bounces get nothing from the closing kick",
        "contacts/closing_kick.py",
        "        p.velocity[row] += by[: len(row), : p.dimension]\n",
        "",
        ("tests/physics/test_closing_kick.py",),
    ),
    Mutation(
        "after a rough contact friction is of the speed before it",
        "contacts/rough.py",
        "        v2_i += (decay_i * v[i, column + k] + force_time_i * a[at, k] + w_i * impulse[k]) ** 2\n",
        "        v2_i += (decay_i * v[i, column + k] + force_time_i * a[at, k]) ** 2\n",
        ("tests/physics/test_order_of_bounces.py", "-k", "rough"),
    ),
    Mutation(
        "fixed particles have a part in the fourth moment of velocities",
        "measure/diagnostics.py",
        '"w^4": square**2 * movable',
        '"w^4": square**2',
        ("tests/physics/test_observables.py", "-k", "temperature"),
    ),
    Mutation(
        "the last substep of adaptive may be as short as the scene's step says",
        "integrators/collocation.py",
        '(s["longest"] if s["longest"] > 0.0 else s["step"])',
        's["step"]',
        ("tests/physics/test_gauss_radau.py", "-k", "very_long"),
    ),
    Mutation(
        "seconds of phases are of all that was computed before, too",
        "run/job.py",
        "total - before.get(name, 0.0)",
        "total",
        ("tests/unit/run/test_parts.py",),
    ),
    Mutation(
        "partners on two ranks get nothing from the closing kick",
        "contacts/closing_kick.py",
        "            by[~met] = self.across_ranks",
        "            by[~met] *= self.across_ranks",
        ("tests/parallel/test_same_bits.py", "-k", "elastic and attract and -2"),
    ),
    Mutation(
        "a trajectory of one writer says that it is longer than it is",
        "output/trajectory.py",
        "            lengthen(self.path, self.file)\n",
        "            pass\n",
        ("tests/parallel/test_output.py", "-k", "1-200"),
    ),
    Mutation(
        "a trajectory of several writers says that it is longer than it is",
        "output/file_length.py",
        "    if new_chunks:\n",
        "    if not new_chunks:\n",
        ("tests/parallel/test_output.py", "-k", "70000"),
    ),
    Mutation(
        "a trajectory has many small chunks",
        "output/layout.py",
        "np.clip(total * frames // CHUNKS + 1, ",
        "np.clip(total, ",
        ("tests/unit/output/test_killed_while_writing.py",),
    ),
    Mutation(
        "a recommended setting reaches the first error only",
        "study/recommend/error_metric.py",
        "for name in ([error] if error else finest)",
        "for name in [first]",
        ("tests/physics/test_recommend.py", "-k", "above_the_tolerance"),
    ),
    Mutation(
        "the energy of a run is compared with that of its start, wherever height is zero",
        "measure/energy_change.py",
        "max(self.kinetic, self.highest - self.lowest)",
        "max(self.kinetic, abs(self.first))",
        ("tests/unit/run/test_remarks.py",),
    ),
    Mutation(
        "spheres without room that friction presses together meet without end",
        "contacts/event_driven/operator.py",
        "MOST_RATTLING if effects.lossy and (forces or effects.on_velocities) else NEVER_CROWDED",
        "NEVER_CROWDED",
        ("tests/hard_cases/test_jammed.py", "-k", "friction_presses"),
    ),
)


def examine(mutation: Mutation, folder: Path) -> str:
    """What the tests say of the fault, in a copy of the repository in `folder`: the first that fails, or "" """
    for name in COPIED:
        source, target = ROOT / name, folder / name
        shutil.copytree(source, target, symlinks=True) if source.is_dir() else shutil.copy2(source, target)
    file = folder / "particles_mpi" / mutation.file
    text = file.read_text()
    if text.count(mutation.old) != 1:
        return f"CANNOT BE MADE: {mutation.file} does not hold the text once, but {text.count(mutation.old)} times"
    file.write_text(text.replace(mutation.old, mutation.new))
    environment = os.environ | {"PYTHONPATH": str(folder)}
    subprocess.run([sys.executable, "-P", folder / "particles_mpi/setup/kernel_sources.py"], check=False, env=environment)
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *mutation.tests]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    found = re.search(r"^(?:FAILED|ERROR) (.*?)(?: - .*)?$", done.stdout, re.M)
    if not found and done.returncode:
        return f"PYTEST FAILED: {done.stdout[-500:]}{done.stderr[-500:]}"
    return found[1] if found else ""


def main() -> None:
    wanted = [one for one in MUTATIONS if not sys.argv[1:] or any(word in one.name for word in sys.argv[1:])]
    unnoticed = 0
    for mutation in wanted:
        begin = perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            told = examine(mutation, Path(folder))
        unnoticed += not told or told.startswith(("CANNOT", "PYTEST"))
        print(f"{mutation.name}: {told or 'NOT NOTICED'} ({perf_counter() - begin:.0f} s)", flush=True)
    sys.exit(bool(unnoticed))


if __name__ == "__main__":
    main()
