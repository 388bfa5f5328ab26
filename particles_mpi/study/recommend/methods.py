"""The ways in which a scene can be computed: integrators, collision modes with passes, direct sum and trees."""

from dataclasses import dataclass
from itertools import product
from typing import Any

from particles_mpi import Scene
from particles_mpi.gravity.method import PAIR_NS, TREES, tree_cost
from particles_mpi.integrators.gauss_radau import TOLERANCE
from particles_mpi.study.recommend.runs import LEAST_SNAPSHOTS, Changes, Start, variant, whole_parts

OPENING_ANGLES = (1.0, 0.7, 0.5, 0.3)
PASSES = (1, 3, 10)
AS_IT_IS = "as it is: "  # begins the name of the settings that the scene has itself
DIRECT: Changes = {"mutual_gravity": {"method": "direct", "opening_angle": None, "accuracy": None, "multipole": None}}
EVENT: Changes = {"collisions": {"mode": "event", "passes": None}}


@dataclass
class Method:
    """A way to compute the scene of a start: its integrator, and `changes` of effects.

    How finely it computes is its resolution: the number of steps of the whole run, or 1/tolerance of `adaptive`. `least`: the
    fewest steps that serve, as where each frame needs one.
    """

    start: Start
    name: str
    integrator: str
    changes: Changes
    least: float = 1.0

    @property
    def adaptive(self) -> bool:
        """Does it choose its steps by a tolerance?"""
        return self.integrator == "adaptive"

    @property
    def ratio(self) -> float:
        """The factor between the resolutions of one setting and the next."""
        return 10.0 if self.adaptive else 2.0

    def steps(self, resolution: float, part: float) -> int:
        """Return the number of steps of a part of the run; `adaptive` only stops where a frame is written."""
        steps = frames(self.start.scene) if self.adaptive else max(resolution, self.least)
        return whole_parts(part * steps, self.start.snapshots(part))

    def whole_steps(self, resolution: float, part: float) -> int:
        """Return the number of steps of the whole run, each as long as those of the measured part (a half, a quarter ...)."""
        return round(self.steps(resolution, part) / part)

    def scene(self, resolution: float, part: float) -> Scene:
        """Return a variant of the scene that ends after a part of the run. SceneError if it is refused."""
        steps = self.steps(resolution, part)
        time: dict[str, Any] = {"step": part * self.start.duration / steps, "steps": steps, "end": None}
        time |= {"integrator": self.integrator, "tolerance": 1.0 / resolution if self.adaptive else None}
        return variant(self.start.scene, time, self.changes)

    def describe(self, resolution: float, part: float) -> str:
        """Return a text: the step, in a measured part of the run, or the tolerance."""
        if self.adaptive:
            return f"tolerance {1.0 / resolution:.2g}"
        return f"step {self.start.duration / self.whole_steps(resolution, part):.4g}"


def frames(scene: Scene) -> float:
    """Return the number of frames that a run writes."""
    return scene.steps / scene.output.every


def methods(start: Start) -> list[Method]:
    """Return all methods that the scene allows."""
    integrators = ["leapfrog", "order4", "adaptive"] if start.smooth else ["leapfrog"]
    if start.scene.time.integrator == "taylor":
        integrators.append("taylor")
    sums, found = ways_to_attract(start), []
    for (gravity, attraction), (mode, contact), integrator in product(sums, ways_to_collide(start), integrators):
        if integrator == "adaptive" and gravity not in ("", "direct sum"):
            continue  # a tree's forces jump where a cell is opened: no polynomial fits them
        parts = [integrator if mode == "" or len(integrators) > 1 else "", gravity if len(sums) > 1 else "", mode]
        found.append(Method(start, ", ".join(filter(None, parts)), integrator, attraction | contact))
    return found


def tree_of(angle: float) -> Changes:
    """Return the changes for gravity by a tree with this opening angle."""
    return {"mutual_gravity": {"method": "tree", "opening_angle": angle, "accuracy": None}}


def ways_to_attract(start: Start) -> list[tuple[str, Changes]]:
    """Return the changes for the direct sum, and for trees if they are less work."""
    if "mutual_gravity" not in start.scene.effects:
        return [("", {})]
    options, angles = start.scene.effects["mutual_gravity"], set(OPENING_ANGLES if start.scene.dimension in TREES else ())
    if options.method == "tree" and angles:
        angles.add(options.opening_angle or 0.5)
    less_work = [angle for angle in angles if tree_cost(angle, start.total, "quadrupole") < PAIR_NS * start.total]
    return [*((f"angle {angle:g}", tree_of(angle)) for angle in sorted(less_work, reverse=True)), ("direct sum", DIRECT)]


def ways_to_collide(start: Start) -> list[tuple[str, Changes]]:
    """Return the changes for mode event, and for mode rewind with few passes and with many."""
    if "collisions" not in start.scene.effects:
        return [("", {})]
    options = start.scene.effects["collisions"]
    found = [("event", EVENT)]
    for passes in sorted({*PASSES, *([options.passes] if options.mode == "rewind" else [])}):
        changes: Changes = {"collisions": {"mode": "rewind", "passes": passes, "contact_duration": None}}
        found.append((f"rewind, {passes} pass{'es' if passes > 1 else ''}", changes))
    return found


def as_it_is(start: Start) -> tuple[Method, float]:
    """Return the scene's own method and resolution; gravity by `auto` counts as the method that it chooses."""
    changes: Changes = {}
    scene, name = start.scene, start.scene.time.integrator
    gravity, contact = scene.effects.get("mutual_gravity"), scene.effects.get("collisions")
    if gravity:
        angle = gravity.choice(scene, start.total).angle
        changes = tree_of(angle) if angle else DIRECT
    if contact:
        name = f"{contact.mode}, {contact.passes} passes" if contact.mode == "rewind" else contact.mode
    resolution = 1.0 / (scene.time.tolerance or TOLERANCE) if name == "adaptive" else float(max(scene.steps, LEAST_SNAPSHOTS))
    return Method(start, AS_IT_IS + name, scene.time.integrator, changes), resolution
