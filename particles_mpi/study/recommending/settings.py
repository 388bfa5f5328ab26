"""The ways in which a scene can be computed: integrators, collision modes with passes, direct sum and trees; each a curve of
errors against cost, along which the step changes, or the tolerance of `adaptive`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from particles_mpi import Scene
from particles_mpi.gravity.method import PAIR, TREES, tree_cost
from particles_mpi.study.recommending.starts import DIRECT, Start, variant
from particles_mpi.study.recommending.tracks import LOOKS, whole

ANGLES = (1.0, 0.7, 0.5, 0.3)
PASSES = (1, 3, 10)

Changes = dict[str, dict[str, Any] | None]


@dataclass
class Curve:
    """`changes`: of effects. `fineness` along it: steps of the whole run, or 1/tolerance of `adaptive`."""

    start: Start
    name: str
    integrator: str
    changes: Changes

    @property
    def adaptive(self) -> bool:
        return self.integrator == "adaptive"

    @property
    def ratio(self) -> float:
        """Of the fineness from one setting to the next."""
        return 10.0 if self.adaptive else 2.0

    @property
    def monotone(self) -> bool:
        """Is a finer setting a dearer one? Contacts are found at a price that depends on the step in other ways."""
        return "collisions" not in self.start.scene.effects

    def steps(self, fineness: float, part: float) -> int:
        """Of a part of the run; `adaptive` only stops where a frame is written."""
        scene = self.start.scene
        return whole(part * (scene.steps / scene.output.every if self.adaptive else fineness))

    def scene(self, fineness: float, part: float) -> Scene:
        """A variant of the scene that ends after a part of the run. SceneError if it is refused."""
        steps = self.steps(fineness, part)
        time: dict[str, Any] = {"step": part * self.start.duration / steps, "steps": steps, "integrator": self.integrator}
        if self.adaptive:
            time["tolerance"] = 1.0 / fineness
        return variant(self.start.scene, time, self.changes)

    def words(self, fineness: float) -> str:
        """The value of the knob, for people."""
        if self.adaptive:
            return f"tolerance {1.0 / fineness:.2g}"
        return f"step {self.start.duration / self.steps(fineness, 1.0):.4g}"


def curves(start: Start) -> list[Curve]:
    """All that the scene allows."""
    found = []
    integrators = ["leapfrog", "order4", "adaptive"] if start.free else ["leapfrog"]
    if start.scene.time.integrator == "taylor":
        integrators.append("taylor")
    sums, contacts = gravities(start), collisions(start)
    for gravity, attraction in sums:
        for mode, meeting in contacts:
            for integrator in integrators:
                if integrator == "adaptive" and gravity not in ("", "direct sum"):
                    continue  # a tree's forces jump where a cell is opened: no polynomial fits them
                parts = [integrator if mode == "" or len(integrators) > 1 else "", gravity if len(sums) > 1 else "", mode]
                found.append(Curve(start, ", ".join(filter(None, parts)), integrator, attraction | meeting))
    return found


def gravities(start: Start) -> list[tuple[str, Changes]]:
    """The direct sum, and trees where they are less work."""
    if "mutual_gravity" not in start.scene.effects:
        return [("", {})]
    options = start.scene.effects["mutual_gravity"]
    found: list[tuple[str, Changes]] = []
    if start.scene.dimension in TREES:
        own = [options.opening_angle or 0.5] if options.method == "tree" else []
        for angle in sorted({*ANGLES, *own}, reverse=True):
            if tree_cost(angle, start.total, "quadrupole") < PAIR * start.total:
                changes = {"method": "tree", "opening_angle": angle, "accuracy": None}
                found.append((f"angle {angle:g}", {"mutual_gravity": changes}))
    return [*found, ("direct sum", {"mutual_gravity": DIRECT})]


def collisions(start: Start) -> list[tuple[str, Changes]]:
    """Mode event, and mode rewind with few passes and many."""
    if "collisions" not in start.scene.effects:
        return [("", {})]
    options = start.scene.effects["collisions"]
    own = {options.passes} if options.mode == "rewind" else set()
    found: list[tuple[str, Changes]] = [("event", {"collisions": {"mode": "event", "passes": None}})]
    for passes in sorted({*PASSES, *own}):
        changes = {"mode": "rewind", "passes": passes, "contact_duration": None}
        found.append((f"rewind, {passes} pass{'es' if passes > 1 else ''}", {"collisions": changes}))
    return found


def own(start: Start) -> tuple[Curve, float]:
    """The scene as it is, as a curve and a place on it; `auto` counts as what it chooses."""
    scene, changes, name = start.scene, {}, start.scene.time.integrator
    gravity, contact = scene.effects.get("mutual_gravity"), scene.effects.get("collisions")
    if gravity:
        angle = gravity.choice(scene, start.total).angle
        changes["mutual_gravity"] = {"method": "tree", "opening_angle": angle, "accuracy": None} if angle else DIRECT
    if contact:
        name = f"{contact.mode}, {contact.passes} passes" if contact.mode == "rewind" else contact.mode
    from particles_mpi.integrators.gauss_radau import TOLERANCE

    fineness = 1.0 / (scene.time.tolerance or TOLERANCE) if name == "adaptive" else float(max(scene.steps, LOOKS))
    return Curve(start, f"as it is: {name}", scene.time.integrator, dict(changes)), fineness
