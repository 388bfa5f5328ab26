"""Speed, as tables: `python tests/benchmarks/speed.py CASE|all [--runs 5] [--readme] [--peers]`; `--help` lists the cases.

Each case is run several times, the settings in turn, and the median and range are printed and written to
out/benchmarks/CASE.csv. Shared machines are noisy: compare medians of one call, not of two. `all --readme` writes the table of
tests/README.md, so that no row is older than another. `--peers` measures REBOUND and pytreegrav in the same turns, where they are
installed (`pip install rebound pytreegrav`).
"""

import argparse
import csv
import json
import os
import re
import sys
import tempfile
from datetime import date
from functools import cache
from importlib.util import find_spec
from math import pi
from pathlib import Path
from statistics import median
from time import perf_counter

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from ranks import ROOT, run_ranks  # noqa: E402

SCENES = ROOT / "particles_mpi" / "scenes"


def mpirun(ranks, *arguments):
    """Output of `python arguments...` on ranks that are started for it."""
    done = run_ranks(ranks, *arguments, timeout=1000, fresh=True)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, arguments))} on {ranks} ranks failed:\n{done.stderr[-2000:]}")
    return done.stdout


def gas(count, effects, steps=100, step=0.02):
    """The headline's density, speed, radius and step with any number of particles."""
    side = 4.0 * (count / 32000) ** (1 / 3)
    return {
        "dimension": 3,
        "box": {"lower": [0.0] * 3, "upper": [side] * 3},
        "time": {"step": step, "steps": steps},
        "particles": [
            {"count": count, "position": "random", "velocity": {"speed": 0.5}, "radius": 0.01, "mass": {"min": 0.1, "max": 0.5}}
        ],
        "effects": effects,
    }


def told(tables, ranks, warm, steps, *folder):
    """What steps.py says of the scene."""
    with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
        file.write(json.dumps(tables))
        file.flush()
        return json.loads(mpirun(ranks, HERE / "steps.py", file.name, warm, steps, *folder).strip().splitlines()[-1])


def steps_of(tables, ranks, warm, steps):
    """ns a particle-step, slowest rank."""
    said = told(tables, ranks, warm, steps)
    return said["seconds"] / said["steps"] / said["particles"] * 1e9


def run(scene, ranks):
    """(seconds of the whole process, run.json) of `particles-mpi run`."""
    with tempfile.TemporaryDirectory() as folder:
        begin = perf_counter()
        mpirun(ranks, "-m", "particles_mpi", "run", scene, "--output", folder, "--overwrite", "--quiet")
        return perf_counter() - begin, json.loads((Path(folder) / "run.json").read_text())


COLLIDING = {"collisions": {"restitution": 1.0}, "walls": {"restitution": 1.0}}
FALLING = {"uniform_gravity": {"acceleration": [0.0, 0.0, -9.80665]}}


def headline():
    """headline.toml, seconds of the loop"""
    return {f"{r} ranks": lambda r=r: run(SCENES / "headline.toml", r)[1]["timers"]["loop"]["max"] for r in (1, 2)}


def flat():
    """ns a particle-step on one core at the headline's density"""
    sizes = {30_000: 200, 100_000: 100, 300_000: 50, 1_000_000: 30}
    return {f"N = {n}": lambda n=n, s=s: steps_of(gas(n, COLLIDING), 1, 30, s) for n, s in sizes.items()}


def ranks():
    """N = 200 000 colliding spheres, ns a particle-step"""
    return {f"{r} ranks": lambda r=r: steps_of(gas(200_000, COLLIDING), r, 30, 60) for r in (1, 2)}


def walls():
    """gravity and walls, no pairs, ns a particle-step on one core"""

    def once(n, e):
        return steps_of(gas(n, FALLING | {"walls": {"restitution": e}}, step=0.002), 1, 10, 15_000_000 // n)

    return {f"N = {n}, e = {e}": lambda n=n, e=e: once(n, e) for n in (32_000, 1_000_000) for e in (1.0, 0.9)}


def heap(n, side):
    """Spheres that fall into a box and come to rest."""
    return {
        "dimension": 3,
        "seed": 1,
        "box": {"lower": [0.0] * 3, "upper": [side, side, 3.0]},
        "time": {"step": 0.005, "steps": 500},
        "particles": [{"count": n, "position": "random", "radius": {"min": 0.045, "max": 0.05}}],
        "effects": {
            "uniform_gravity": {"acceleration": [0.0, 0.0, -9.81]},
            "walls": {"restitution": 0.5},
            "collisions": {"mode": "event", "restitution": 0.5},
        },
    }


def bed(n=10_000, side=3.16):
    """spheres that fall into a box and come to rest, mode event, e = 0.5, ns a particle-step: the fall and the settled bed"""
    parts = {"fall": (0, 160), "settled": (450, 50)}
    return {
        f"N = {n}, {part}, {r} ranks": lambda warm=warm, steps=steps, r=r: steps_of(heap(n, side), r, warm, steps)
        for part, (warm, steps) in parts.items()
        for r in (1, 2)
    }


def large_bed():
    """the same of 100 000 spheres: a quarter of an hour, not among `all`"""
    return bed(100_000, 10.0)


def fluid(n, step, periodic=True, mode="event"):
    """Hard spheres at packing 0.30."""
    side = (n * pi / 6 / 0.30) ** (1 / 3)
    return {
        "dimension": 3,
        "box": {"lower": [0.0] * 3, "upper": [side] * 3, "periodic": periodic},
        "time": {"step": step, "steps": 10},
        "particles": [{"count": n, "position": "lattice", "velocity": {"temperature": 1.0}, "radius": 0.5, "mass": 1.0}],
        "effects": {"collisions": {"mode": mode}} | ({} if periodic else {"walls": {}}),
    }


def events():
    """mode event, hard-sphere fluid at packing 0.30, thousand collisions a second on one core"""

    def rate(n, steps):
        said = told(fluid(n, 0.4), 1, 4, steps)  # four collisions of each particle in a step
        return said["collisions"] / said["seconds"] / 1e3

    return {f"N = {n}": lambda n=n, s=s: rate(n, s) for n, s in {4_000: 200, 32_000: 25, 108_000: 8}.items()}


def event_ranks():
    """mode event, 100 000 hard spheres at packing 0.30, thousand collisions a second; and windows redone, %"""

    def rate(r, periodic):
        said = told(fluid(100_000, 0.3, periodic), r, 2, 3)
        if said["windows"][0]:
            print("  {} windows, {} redone".format(*said["windows"]))
        return said["collisions"] / said["seconds"] / 1e3

    return {f"{r} ranks, {'periodic' if p else 'walls'}": lambda r=r, p=p: rate(r, p) for p in (True, False) for r in (1, 2)}


def to_collision():
    """one call of step_to_collision, a gas of the headline's density, one core, ms"""

    def call(n, effects):
        sim = Simulation(Scene.from_dict(gas(n, COLLIDING | effects)))
        sim.step_to_collision()
        begin = perf_counter()
        for _ in range(20):
            sim.step_to_collision()
        return (perf_counter() - begin) / 20 * 1e3

    from particles_mpi import Scene, Simulation

    kinds = {"no forces": {}, "gravity": FALLING}
    return {f"N = {n}, {kind}": lambda n=n, e=e: call(n, e) for n in (1000, 30_000) for kind, e in kinds.items()}


def memory():
    """memory on one core, output included: bytes a particle, and as a part of what the plan tells"""

    @cache
    def growth(kind, small, large, steps):
        said = []
        for n in (small, large):
            tables = KINDS[kind](n)
            tables |= {"time": tables["time"] | {"steps": steps}, "output": {"every": steps}}
            with tempfile.TemporaryDirectory() as folder:
                said.append(told(tables, 1, 0, 0, folder))
        return [(said[1][name] - said[0][name]) / (said[1]["particles"] - said[0]["particles"]) for name in ("memory", "told")]

    KINDS = {
        "no pairs": lambda n: gas(n, FALLING | {"walls": {}}),
        "rewind, dilute": lambda n: gas(n, COLLIDING),
        "rewind, packing 0.30": lambda n: fluid(n, 0.02, mode="rewind"),
        "event, packing 0.30": lambda n: fluid(n, 0.1),
        "a bed that settles": lambda n: heap(n, 3.16 * (n / 10_000) ** 0.5),
        "tree": lambda n: sphere(n, {"method": "tree", "opening_angle": 0.45}, 4),
    }
    sizes = dict.fromkeys(KINDS, (200_000, 600_000, 4)) | {"a bed that settles": (10_000, 30_000, 200)}
    parts = {"": lambda used, _: used, ", of what is told": lambda used, said: used / said}
    return {
        f"{kind}{name}": lambda kind=kind, of=of: of(*growth(kind, *sizes[kind])) for kind in KINDS for name, of in parts.items()
    }


def direct():
    """mutual gravity by direct sum, N = 4096, one core, ns a pair"""
    tables = {
        "dimension": 3,
        "G": 1.0,
        "box": {"lower": [0.0] * 3, "upper": [1.0] * 3},
        "time": {"step": 1e-4, "steps": 30},
        "particles": [{"count": 4096, "position": "random", "velocity": [0.0] * 3, "mass": 1.0}],
        "effects": {"mutual_gravity": {"softening": 0.01}},
    }
    return {"N = 4096": lambda: steps_of(tables, 1, 5, 20) / 4096}


def sphere(n, gravity, steps):
    """A Plummer sphere in equilibrium."""
    return {
        "dimension": 3,
        "G": 1.0,
        "time": {"step": 1e-4, "steps": steps},
        "particles": [{"count": n, "position": {"plummer": 1.0}, "velocity": "equilibrium", "mass": 1.0 / n}],
        "effects": {"mutual_gravity": gravity},
    }


def tree():
    """mutual gravity by tree at a median force error of 1.5e-4, Plummer sphere, one core, microseconds a particle"""

    def once(n):
        return steps_of(sphere(n, {"method": "tree", "opening_angle": 0.45}, 4), 1, 1, 3) / 1e3

    return {f"N = {n}": lambda n=n: once(n) for n in (10_000, 100_000, 1_000_000)}


def gravity_ranks():
    """mutual gravity, Plummer sphere of 100 000, microseconds a particle-step"""

    def once(method, r):
        gravity = {"method": method} | ({"opening_angle": 0.45} if method == "tree" else {})
        return steps_of(sphere(100_000, gravity, 4), r, 1, 3 if method == "tree" else 1) / 1e3

    return {f"{method}, {r} ranks": lambda m=method, r=r: once(m, r) for method in ("tree", "direct") for r in (1, 2)}


def start():
    """whole process of a run of one step of headline.toml, seconds"""
    text = (SCENES / "headline.toml").read_text().replace("steps = 500", "steps = 1").replace("every = 500", "every = 1")

    def once(r):
        with tempfile.NamedTemporaryFile("w", suffix=".toml") as file:
            file.write(text)
            file.flush()
            return run(file.name, r)[0]

    return {f"{r} ranks": lambda r=r: once(r) for r in (1, 2)}


def frames():
    """one frame of a million particles, ms"""
    text = """dimension = 3
box = {lower = [0, 0, 0], upper = [100, 100, 100]}
time = {step = 0.01, steps = 8}
particles = [{count = 1000000, position = "random", velocity = {speed = 0.5}, radius = 0.01}]
effects = {}
output = {every = 1, checkpoint_every = 8, formats = ["hdf5"]}
"""

    def once(r):
        with tempfile.NamedTemporaryFile("w", suffix=".toml") as file:
            file.write(text)
            file.flush()
            return run(file.name, r)[1]["timers"]["output"]["max"] / 9 * 1e3

    return {f"{r} ranks": lambda r=r: once(r) for r in (1, 2)}


def few():
    """few bodies on one core: thousand steps/s of the figure eight by each integrator; milliseconds of whole integrations"""

    def rate(integrator, steps, collide=False):
        tables = Scene.load(SCENES / "figure_eight.toml").to_dict()
        if collide:
            tables["particles"] = [table | {"radius": 0.01} for table in tables["particles"]]
            tables["effects"]["collisions"] = {}
        sim = Simulation(Scene.from_dict(tables | {"time": tables["time"] | {"integrator": integrator, "steps": 10 * steps}}))
        sim.steps(steps // 10)
        begin = perf_counter()
        sim.steps(steps)
        return steps / (perf_counter() - begin) / 1e3

    def pythagorean():
        sim = Simulation(Scene.load(SCENES / "pythagorean.toml"))
        sim.step()
        begin = perf_counter()
        sim.run()
        return (perf_counter() - begin) * 1e3

    from particles_mpi import Scene, Simulation

    lengths = {"leapfrog": 2_000_000, "taylor": 2_000_000, "order4": 400_000, "adaptive": 40_000}
    rates = {f"{name}, 1000 steps/s": lambda name=name, steps=steps: rate(name, steps) for name, steps in lengths.items()}
    rates["leapfrog, spheres that collide, 1000 steps/s"] = lambda: rate("leapfrog", 2_000_000, collide=True)
    solar = {
        "solar_system.toml, the loop with all output, ms": lambda: (
            run(SCENES / "solar_system.toml", 1)[1]["timers"]["loop"]["max"] * 1e3
        )
    }
    return rates | {"Pythagorean problem to t = 70, ms": pythagorean} | solar


def few_peers():
    """REBOUND: the same"""
    import rebound

    def simulation(mass, x, v, radius=0.0):
        sim = rebound.Simulation()
        for m, place, speed in zip(mass, x, v, strict=True):
            sim.add(m=m, x=place[0], y=place[1], vx=speed[0], vy=speed[1], r=radius)
        return sim

    def leapfrog(collide=False):
        a, b = [0.97000435669733434, -0.24308753153583489], [0.46620368572055115, 0.43236573046050048]
        sim = simulation([1.0] * 3, [a, [-a[0], -a[1]], [0.0, 0.0]], [b, b, [-2 * b[0], -2 * b[1]]], 0.01 * collide)
        if collide:
            sim.collision, sim.collision_resolve = "direct", "hardsphere"
        sim.integrator, sim.dt = "leapfrog", 0.0015814784957455528
        begin = perf_counter()
        sim.steps(2_000_000)
        return 2_000_000 / (perf_counter() - begin) / 1e3

    def pythagorean():
        sim = simulation([3.0, 4.0, 5.0], [[1.0, 3.0], [-2.0, -1.0], [1.0, -1.0]], [[0.0, 0.0]] * 3)
        sim.integrator = "ias15"
        begin = perf_counter()
        sim.integrate(70.0)
        return (perf_counter() - begin) * 1e3

    return {
        "REBOUND leapfrog, 1000 steps/s": leapfrog,
        "REBOUND leapfrog, spheres that collide, 1000 steps/s": lambda: leapfrog(collide=True),
        "REBOUND IAS15, Pythagorean problem to t = 70, ms": pythagorean,
    }


def tree_peers():
    """pytreegrav: the same at about the same error"""
    import numpy as np
    from pytreegrav import Accel

    def once(n):
        generator = np.random.default_rng(1)
        radius = 1.0 / np.sqrt(generator.random(n) ** (-2.0 / 3.0) - 1.0)
        way = generator.standard_normal((n, 3))
        x = radius[:, None] * way / np.sqrt((way**2).sum(axis=1))[:, None]
        mass, h = np.full(n, 1.0 / n), np.zeros(n)
        Accel(x[:100], mass[:100], h[:100], theta=0.5, quadrupole=True, method="tree")
        begin = perf_counter()
        Accel(x, mass, h, theta=0.5, quadrupole=True, method="tree")
        return (perf_counter() - begin) / n * 1e6

    return {f"pytreegrav, N = {n}": lambda n=n: once(n) for n in (10_000, 100_000)}


ALL = (
    few,
    headline,
    flat,
    ranks,
    walls,
    bed,
    events,
    event_ranks,
    to_collision,
    direct,
    tree,
    gravity_ranks,
    start,
    frames,
    memory,
)
CASES = {case.__name__: case for case in (*ALL, large_bed)}
PEERS = {"few": ("rebound", few_peers), "tree": ("pytreegrav", tree_peers)}
ONCE = {"bed", "large_bed", "memory"}  # cases of many minutes, which are run once, and what does not vary
FIRST = re.compile(r"(\| `headline.toml`[^|]*\| )[^(]*")  # the row of README.md
TABLE = re.compile(r"(<!-- speed -->\n).*(<!-- end of speed -->)", re.DOTALL)


def measured(name, runs, peers):
    """[label, median, smallest, largest, median of the ratios to the first] of each setting of a case; printed and kept."""
    settings = CASES[name]()
    module, of_peer = PEERS.get(name, ("", None))
    if peers and module and find_spec(module):
        settings |= of_peer()
    figures = {label: [] for label in settings}
    for _ in range(1 if name in ONCE else runs):
        for label, measure in settings.items():
            figures[label].append(measure())
    base = next(iter(figures))
    print(f"{name}: {CASES[name].__doc__}", flush=True)
    rows = []
    for label, values in figures.items():
        ratio = median(b / a for a, b in zip(figures[base], values, strict=True))
        rows.append([label, median(values), min(values), max(values), ratio])
        _, middle, low, high, _ = rows[-1]
        print(f"  {label:18} median {middle:9.3f}   range {low:.3f} .. {high:.3f}   to the first: {ratio:.3f}", flush=True)
    with (ROOT / "out" / "benchmarks" / f"{name}.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["setting", "median", "min", "max", "median of paired ratios to the first"], *rows])
    return rows


def write_table(found):
    """The table of tests/README.md: a row for each case, the medians of its settings and their ranges; and a row of README.md."""
    told = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
    cpu = told[0].split(":")[1].strip() if told else "unknown CPU"
    lines = [f"{date.today()}, {cpu}, {os.cpu_count()} cores. Medians, and in brackets the range of all runs.", ""]
    lines += ["| what | figures | `speed.py` |", "|---|---|---|"]
    for name, rows in found.items():
        figures = "; ".join(f"{label}: {middle:.4g} ({low:.4g} to {high:.4g})" for label, middle, low, high, _ in rows)
        lines.append(f"| {CASES[name].__doc__} | {figures} | `{name}` |")
    loops = " and ".join(f"{middle:.2f} s" for _, middle, *_ in found["headline"])
    front = ROOT / "README.md"
    front.write_text(FIRST.sub(lambda old: f"{old[1]}{loops} ", front.read_text()))
    page = ROOT / "tests" / "README.md"
    page.write_text(TABLE.sub(lambda old: old[1] + "\n".join(lines) + "\n" + old[2], page.read_text()))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", choices=[*CASES, "all"])
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--readme", action="store_true", help="with all: write the table of tests/README.md")
    parser.add_argument("--peers", action="store_true", help="measure other programs too, where they are installed")
    options = parser.parse_args()
    (ROOT / "out" / "benchmarks").mkdir(parents=True, exist_ok=True)
    names = [case.__name__ for case in ALL] if options.case == "all" else [options.case]
    found = {name: measured(name, options.runs, options.peers) for name in names}
    if options.readme and options.case == "all":
        write_table(found)


if __name__ == "__main__":
    main()
