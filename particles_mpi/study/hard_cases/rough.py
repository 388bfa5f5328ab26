"""Rough spheres: what friction holds up and what it does not, fast spins, mu = 0 and 1e6, very unlike masses."""

from math import asin, atan, cos, pi, radians, sin, sqrt, tan

import numpy as np

from particles_mpi import Simulation
from particles_mpi.study.experiment import all_particles
from particles_mpi.study.hard_cases.catalogue import CaseRun, Effects, Finding, case, energies, largest_rise

G, SPIN = 9.81, 1e6
BESIDE_LIMIT = (0.99, 1.01)  # parts of the coefficient of friction that statics asks for: below it and above
MOST_RISE = 1e-6  # of the energy at the start, at most


def solid(run: CaseRun) -> float:
    """Return I/(m R^2) of a disc in the plane, or of a sphere in space."""
    return 0.5 if run.dimension == 2 else 0.4


def surfaces(run: CaseRun, gravity: list[float], friction: float, normals: list[list[float]], e: float = 0.0) -> Effects:
    """Return the effects: gravity, spheres and planes through the origin, all with this friction and restitution."""
    law = {"restitution": e, "friction": friction}
    planes = {"planes": [{"point": run.point(), "normal": normal} for normal in normals]}
    return {"uniform_gravity": {"acceleration": gravity}, "collisions": dict(law), "walls": law | planes}


def spinning(run: CaseRun, speed: float) -> list[float]:
    """Return the spin of a sphere that turns in the plane of the first and last axis: a number in 2D, a vector in 3D.

    At speed > 0 the lowest point of the sphere moves along the first axis, so that friction of a floor pushes the sphere
    backwards along it.
    """
    return [speed] if run.dimension == 2 else [0.0, -speed, 0.0]


def energy_rise(sim: Simulation, time: float) -> float:
    """Run for a time; returns by how much the energy rose over the least before, in parts of that at the start. Collective."""
    return largest_rise(energies(sim, round(time / sim.h)))


@case(
    "a ball that spins at 1e6 falls on a floor", "thrown off at the speed of its surface", "v_t = mu (1 + e) v_n; then a = mu g"
)
def top_speed(run: CaseRun) -> Finding:
    """A ball hits the floor without gravity, and another ball lies on it."""
    mu, e, fall, radius = 0.3, 0.7, 2.0, 0.5
    ball = {"position": [run.upright(0.51)], "velocity": run.upright(-fall), "spin": spinning(run, SPIN), "radius": radius}
    floor = surfaces(run, run.point(), mu, [run.upright(1.0)], e)
    _, p = run.finish([ball], 0.01, effects=floor)
    given = mu * (1.0 + e) * fall
    off = float(np.abs(p.velocity[0] - (np.eye(run.dimension)[0] * -given + run.upright(e * fall))).max())
    slower = float(np.abs(p.spin[0] - spinning(run, SPIN - given / (solid(run) * radius))).max() / SPIN)
    lying = {"position": [run.upright(radius)], "spin": spinning(run, SPIN), "radius": radius}
    sim, p = run.finish([lying], 0.01, 100, surfaces(run, run.upright(-G), mu, [run.upright(1.0)], e))
    on = abs(p.velocity[0, 0] / (mu * G * sim.time) + 1.0)
    holds = off <= 1e-15 * 4 and slower <= 1e-15 and on <= 1e-9
    return f"v off {off:.0e}, spin {slower:.0e} of itself; on the floor v off {on:.0e} of mu g t", bool(holds)


@case(
    "mu = 0 and mu = 1e6: hits, and a ball on a slope of 45 degrees",
    "0/0 where nothing slips, or an endless search for where it sticks",
    "mu = 0: slides without turning; mu = 1e6: the bits of no limit at all, rolls with g sin/(1 + I/(m R^2))",
)
def extreme_friction(run: CaseRun) -> Finding:
    """An off-centre hit with each coefficient and without a limit; a ball that starts on the slope."""
    thrown = [{"position": [run.point(-1.2, 0.3)], "velocity": run.point(3.0), "radius": 0.5, "spin": spinning(run, 2.0)}]
    thrown.append({"position": [run.point()], "radius": 0.5})

    def after(**law: float) -> tuple[bytes, bytes]:
        _, p = run.finish(thrown, 0.05, 20, {"collisions": {"restitution": 0.9, "tangential_restitution": 0.0, **law}})
        return p.velocity.tobytes(), p.spin.tobytes()

    same, off = after(friction=1e6) == after(), 0.0
    gravity = (G * sqrt(0.5) * (np.eye(run.dimension)[0] - run.upright(1.0))).tolist()
    for mu, part in ((0.0, 0.0), (1e6, solid(run))):
        ball = {"position": [run.upright(0.5)], "radius": 0.5}
        sim, p = run.finish([ball], 0.002, 100, surfaces(run, gravity, mu, [run.upright(1.0)]))
        off = max(off, abs(p.velocity[0, 0] * (1.0 + part) / (gravity[0] * sim.time) - 1.0))
    return f"{'same' if same else 'OTHER'} bits as without a limit, v on the slope off {off:.0e}", same and off <= 1e-9


@case(
    "rough hits at mass ratios of 1e-6 to 1e6",
    "momentum lost to round-off, the spin of the light one explodes",
    "momenta within 1e-15 of their parts, energy falls",
)
def mass_ratios(run: CaseRun) -> Finding:
    """A ball of mass 1 hits one at rest off centre; both spin."""
    lost, risen = 0.0, -np.inf
    for mass in 10.0 ** np.arange(-6, 7):
        sizes = {"radius": 0.5, "spin": spinning(run, 5.0)}
        pair = [{"position": [run.point(-1.2, 0.3)], "velocity": run.point(3.0), "mass": 1.0, **sizes}]
        pair.append({"position": [run.point()], "mass": float(mass), **sizes})
        sim = run.simulate(pair, 0.02, effects={"collisions": {"restitution": 0.8, "friction": 0.4}})
        first = sim.measure()
        sim.steps(20)
        last = sim.measure()
        size = max(3.0, 5.0 * solid(run) * 0.25 * mass)  # the largest part that a momentum is the sum of
        lost = max(lost, *(abs(last[name] - first[name]) / size for name in first if "momentum" in name))
        risen = max(risen, last["total_energy"] / first["total_energy"] - 1.0)
    return f"momenta off {lost:.0e}, energy {risen:+.0e} at least", bool(lost <= 1e-15 * 2 and risen < 0.0)


@case(
    "a ball that spins in a groove of 90 degrees",
    "climbs, or gains energy, as each wall drags it onto the other",
    "d spin/dt = -sqrt(2) mu g m R/((1 + mu^2) I), in its place, down to exactly 0",
)
def spinning_in_a_groove(run: CaseRun) -> Finding:
    """Both contacts slide: N_1 + N_2 = sqrt(2) m g/(1 + mu^2) by the balance of forces, and mu R (N_1 + N_2) is the couple."""
    mu, spin, radius, up = 0.3, 20.0, 0.5, sqrt(0.5)
    groove = surfaces(
        run, run.upright(-G), mu, [(side * np.eye(run.dimension)[0] + run.upright(up)).tolist() for side in (up, -up)]
    )
    place = run.upright(radius / up)
    sim = run.simulate([{"position": [place], "spin": spinning(run, spin), "radius": radius}], 0.002, effects=groove)
    slowing = sqrt(2.0) * mu * G / ((1.0 + mu * mu) * solid(run) * radius)
    rise = energy_rise(sim, 0.5)
    off = float(np.abs(all_particles(sim).spin[0] - spinning(run, spin - 0.5 * slowing)).max() / spin)
    rise = max(rise, energy_rise(sim, spin / slowing - 0.4))
    p = all_particles(sim)
    moved, still = float(np.abs(p.position[0] - place).max()), not p.velocity.any() and not p.spin.any()
    holds = off <= 1e-9 and moved <= 1e-9 and still and rise <= MOST_RISE
    return f"spin off {off:.0e}, moved {moved:.0e}, {'at rest' if still else 'NOT at rest'}, E rose {rise:.0e}", holds


@case(
    "a ball rolls or slides down a groove of 90 degrees",
    "rolls on its radius, or both contacts share its weight badly",
    "rolls on R cos 45 with g sin/1.8 up to tan = 3.18 mu, slides above 3.34 mu with g sin - sqrt(2) mu g cos",
    dimensions=(3,),
)
def down_a_groove(run: CaseRun) -> Finding:
    """It rolls with I/(m r^2) = 2/5/cos^2 45 = 0.8, moved by friction, while N = m g cos/sqrt(2) at each wall is enough for that.

    Friction across the groove can press the ball onto both walls with f each: N + f, and sqrt(f^2 + F^2) <= mu (N + f) for the
    friction F along it. So F may be up to mu N/sqrt(1 - mu^2); between that and mu N rolling and sliding both obey Coulomb's law.
    """
    mu, up, off = 0.3, sqrt(0.5), 0.0
    for part in (0.2, BESIDE_LIMIT[0], BESIDE_LIMIT[1] / sqrt(1.0 - mu * mu), 2.0):
        angle = atan(part * mu * sqrt(2.0) * 1.8 / 0.8)
        gravity = [G * sin(angle), 0.0, -G * cos(angle)]
        groove = surfaces(run, gravity, mu, [[0.0, side, up] for side in (up, -up)])
        sim, p = run.finish([{"position": [[0.0, 0.0, 0.5 / up]], "radius": 0.5}], 0.002, 100, groove)
        wanted = G * sin(angle) / 1.8 if part < 1.0 else G * (sin(angle) - sqrt(2.0) * mu * cos(angle))
        off = max(off, abs(p.velocity[0, 0] / (wanted * sim.time) - 1.0))
    return f"v off {off:.0e}", off <= 1e-9


@case(
    "a ball between a floor and a fixed sphere that close at 20 degrees",
    "endless search, thrown out faster than it came, or stuck by forces of its own",
    "pushed in: stays, at any mu; pulled: leaves with a t; thrown in: no deeper, no more energy",
)
def between_floor_and_sphere(run: CaseRun) -> Finding:
    """Rigid rough bodies may be wedged where mu > tan 10 degrees, with forces that nothing decides: here they need a push."""
    angle, moved, off, rise = radians(20.0), 0.0, 0.0, -np.inf
    place = (np.eye(run.dimension)[0] * -2.5 * sin(angle) + run.upright(0.5)).tolist()
    fixed = {"position": [run.upright(0.5 + 2.5 * cos(angle))], "radius": 2.0, "fixed": True}
    for mu in (0.0, 0.1, 0.3, 1e6):
        effects = surfaces(run, run.point(), mu, [run.upright(1.0)]) | {"user_acceleration": {}}
        del effects["uniform_gravity"]
        ball = {"position": [place], "radius": 0.5}
        sim = run.simulate([ball | {"acceleration": run.point(10.0)}, fixed], 0.002, 50, effects)
        sim.steps(50)
        moved = max(moved, float(np.abs(all_particles(sim).position[0] - place).max()))
        sim.particles.acceleration[sim.particles.id == 0] = run.point(-10.0)
        sim.steps(50)
        off = max(off, float(np.abs(all_particles(sim).velocity[0] - run.point(-1.0)).max()))
        sim = run.simulate([ball | {"velocity": run.point(10.0)}, fixed], 0.002, 50, effects)
        rise = max(rise, energy_rise(sim, 0.1))
        moved = max(moved, float(all_particles(sim).position[0, 0] - place[0]))
    holds = moved <= 1e-9 and off <= 1e-9 and rise <= MOST_RISE
    return f"moved {moved:.0e}, pulled: v off {off:.0e}, E rose {rise:.0e}", holds


def stands(sim: Simulation, time: float) -> tuple[float, float]:
    """Return (how far the sphere with the highest id moved within a time, the `energy_rise`). Collective."""
    before, rise = all_particles(sim).position[-1], energy_rise(sim, time)
    return float(np.abs(all_particles(sim).position[-1] - before).max()), rise


def verdict(found: list[tuple[float, float]]) -> Finding:
    """Return the finding from pairs of runs by `stands`: friction just below the limit of statics (must fall), and just above."""
    falls, holds = min(moved for moved, _ in found[::2]), max(moved for moved, _ in found[1::2])
    rise = max(rise for _, rise in found)
    below, above = (f"moved {moved:.0e} at {part:.2f} mu" for moved, part in zip((falls, holds), BESIDE_LIMIT, strict=True))
    return f"{below}, {above}, E rose {rise:.0e}", falls > 5e-4 and holds <= 1e-8 and rise <= MOST_RISE


@case(
    "a pyramid of three discs, four balls; the top 1, 100 and 1e4 times as heavy",
    "stands without friction, or creeps with it",
    "falls at 0.99 mu and stands at 1.01 mu, mu = tan(15 deg) = 0.268, tan(17.6 deg) = 0.318",
)
def pyramid(run: CaseRun) -> Finding:
    """The top bears on each ball below at the angle a from the vertical, and friction is alike at both contacts of that ball.

    The balance of forces across is N sin a = f (1 + cos a), so that f/N = tan(a/2); the floor needs less, as it bears more.
    sin a = 1/2 for discs, 1/sqrt(3) for balls.
    """
    d, found = run.dimension, []
    lean = asin(0.5 if d == 2 else 1.0 / sqrt(3.0))
    turns = [2.0 * pi * k / d for k in range(d)]
    base = [[*[sin(lean) * x for x in (cos(turn), sin(turn))][: d - 1], 0.5] for turn in turns]
    for top in (1.0, 100.0, 1e4):
        balls = {"position": [*base, run.upright(0.5 + cos(lean))], "radius": 0.5, "mass": [1.0] * d + [top]}
        for part in BESIDE_LIMIT:
            effects = surfaces(run, run.upright(-G), part * tan(lean / 2.0), [run.upright(1.0)])
            found.append(stands(run.simulate([balls], 0.004, effects=effects), 0.5))
    return verdict(found)


@case(
    "an arch of two discs of masses 3 and 1 between two fixed ones",
    "falls whatever the friction, or stands whatever it is",
    "falls at 0.99 mu and stands at 1.01 mu, mu = 1/(2 sqrt(3)) = 0.289",
    dimensions=(2,),
)
def arch(run: CaseRun) -> Finding:
    """Lines from the fixed discs rise at 60 degrees. Couples balance if friction f is alike at all three contacts.

    Forces then give f = (m_1 - m_2) g cos/(2 (1 + cos)) = g/3, the lighter one's force on its fixed disc
    N = (m_2 g + f (1 + cos))/sin = sqrt(3) g, and the thrust between both, N cos + f sin = 2 g/sqrt(3). That is the smallest
    of the three normal forces, so that mu must be f over it.
    """
    s, found = sqrt(0.75), []
    fixed = {"position": [[-1.0, 0.0], [1.0, 0.0]], "radius": 0.5, "fixed": True}
    discs = {"position": [[-0.5, s], [0.5, s]], "radius": 0.5, "mass": [3.0, 1.0]}
    for part in BESIDE_LIMIT:
        effects = surfaces(run, run.upright(-G), part / (2.0 * sqrt(3.0)), [run.upright(1.0)])
        del effects["walls"]
        found.append(stands(run.simulate([fixed, discs], 0.004, effects=effects), 0.5))
    return verdict(found)
