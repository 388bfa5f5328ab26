"""Every key that a scene accepts changes what is computed, or is refused: none is ignored.

Scenes of a few discs, with each effect and with combinations of them. In each, one key after another is given another value.
Either the scene is refused, in a message that names the key, or the final state of the same fields differs.
"""

from copy import deepcopy

import pytest

from particles_mpi import Scene, SceneError, Simulation

DISCS = {
    "count": 9,
    "position": "lattice",
    "radius": {"min": 0.3, "max": 0.45},
    "velocity": {"speed": 3.0},
    "mass": {"min": 1.0, "max": 2.0},
}
FLOOR, CEILING = {"point": [0.0, 0.0], "normal": [0.0, 1.0]}, {"point": [0.0, 3.5], "normal": [0.1, -1.0]}
PLANES = [FLOOR, CEILING, {"point": [0.0, 0.0], "normal": [1.0, 0.0]}, {"point": [3.5, 0.0], "normal": [-1.0, 0.0]}]
G = {"uniform_gravity": {"acceleration": [0.5, -20.0]}}
ROUGH = {"restitution": 0.5, "friction": 0.3}
ATTRACTED = {"mutual_gravity": {"G": 1.0, "softening": 0.1}}


def planes(**own):
    return [FLOOR | own, *PLANES[1:]]


EFFECTS = {
    "elastic": {"collisions": {}, "walls": {}},
    "elastic, event": {"collisions": {"mode": "event"}, "walls": {}},
    "lossy": {"collisions": {"restitution": 0.5}, "walls": {"restitution": 0.5}},
    "damped": {"collisions": {"damping": 0.3}, "walls": {"damping": 0.3}},
    "planes": {"collisions": {}, "walls": {"restitution": 0.5, "planes": planes()}},
    "planes, damped": {"walls": {"restitution": 0.5, "planes": planes(damping=0.2)}},
    "planes, rough": {"walls": {"planes": planes(friction=0.3, restitution=0.5)}},
    "walls, rough": {"collisions": {}, "walls": {"friction": 0.3, "restitution": 0.5, "planes": planes()}},
    "walls, sticking": {"walls": {"tangential_restitution": 0.5, "planes": planes(friction=0.2)}},
    "rough": {"collisions": ROUGH, "walls": ROUGH},
    "rough, event": {"collisions": ROUGH | {"mode": "event"}, "walls": ROUGH},
    "pairs alone": {"collisions": ROUGH},
    "heap": {"collisions": {"restitution": 0.5}, "walls": {"restitution": 0.5}} | G,
    "heap, event": {"collisions": {"restitution": 0.5, "mode": "event"}, "walls": {"restitution": 0.5}} | G,
    "rough heap": {"collisions": ROUGH, "walls": ROUGH, "rolling": {"resistance": 0.01}} | G,
    "on walls": {"walls": ROUGH, "rolling": {"resistance": 0.01}} | G,
    "drag": {"drag": {"rate": 0.1}, "friction": {"strength": 0.1}, "user_acceleration": {}, "walls": {}},
    "attracted": ATTRACTED,
    "tree": {"mutual_gravity": {"G": 1.0, "method": "tree", "opening_angle": 0.3}, "collisions": {}},
    "auto": {"mutual_gravity": {"G": 1.0, "method": "auto", "accuracy": 1e-2}},
}  # fmt: skip
LOSSES = {"damping": [0.7], "restitution": [0.7], "friction": [0.1, 0.0], "tangential_restitution": [0.9, -1.0]}
KEYS = {
    ("effects", "collisions"): LOSSES | {"mode": ["rewind", "event"], "contact_duration": [0.3]},
    ("effects", "walls"): LOSSES,
    ("effects", "walls", "planes", 0): LOSSES | {"point": [[0.0, 0.05]], "normal": [[0.1, 1.0]]},
    ("effects", "rolling"): {"resistance": [0.05]},
    ("effects", "drag"): {"rate": [0.4]},
    ("effects", "friction"): {"strength": [0.4]},
    ("effects", "uniform_gravity"): {"acceleration": [[0.5, -15.0]]},
    ("effects",): {"rolling": [{"resistance": 0.03}], "friction": [{"strength": 0.3}], "drag": [{"rate": 0.3}]} | G | ATTRACTED,
    ("effects", "mutual_gravity"): {
        "G": [2.0], "softening": [0.2], "method": ["direct", "tree"], "opening_angle": [0.9], "multipole": ["monopole"],
        "accuracy": [0.1],
    },
    ("particles", 0): {
        "spin": [3.0], "moment_of_inertia": [0.7], "drag": [0.4], "acceleration": [[1.0, 0.0]], "fixed": [[True] + [False] * 8],
        "mass": [3.0], "radius": [0.2], "velocity": [[1.0, 0.5]],
    },
    ("time",): {"step": [0.02], "integrator": ["order4", "taylor", "adaptive"], "tolerance": [1e-4]},
    ("output",): {"orientation": [True]},
}  # fmt: skip


def may_be_alike(effects, key, value):
    """Whether the laws say that this change changes nothing."""
    friction = {"friction", "tangential_restitution"}
    rough = any(key in friction for part in effects.values() for table in [part, *part.get("planes", [])] for key in table)
    lossy = any("restitution" in part or "damping" in part for part in effects.values())
    pressed = "uniform_gravity" in effects
    return {
        "smooth, in other words": (key, value) in {("friction", 0.0), ("tangential_restitution", -1.0)},
        "the same laws, computed in another way": key == "mode",
        "nothing is lost that a lasting contact could keep": key == "contact_duration" and not lossy,
        "without a force the same velocities": key == "integrator" and value == "taylor" and not pressed,
        "a field more": key == "orientation" and rough,
        "so few that all are summed": key in {"opening_angle", "multipole", "accuracy"} or (key, value) == ("method", "direct"),
    }  # fmt: skip


def tables(effects):
    return {
        "dimension": 2, "seed": 5, "box": {"lower": [0, 0], "upper": [3.5, 3.5]}, "time": {"step": 0.01, "steps": 40},
        "particles": [DISCS], "effects": effects, "output": {},
    }  # fmt: skip


def final(given, changed=None):
    """The final state; `changed`: (effect, option, value) that is changed after five steps."""
    sim = Simulation(Scene.from_dict(given))
    for step in range(40):
        if changed and step == 5:
            setattr(sim.effects[changed[0]], *changed[1:])
        sim.step()
    return {name: array.tobytes() for name, array in sim.particles.arrays.items()}


def changes(given):
    """(place of a table, key, value) of all changes of a scene."""
    for place, keys in KEYS.items():
        table = given
        for part in place:
            table = table[part] if isinstance(part, int) else table.get(part)
            if table is None:
                break
        else:
            for key, values in keys.items():
                for value in values if isinstance(values, list) else [values]:
                    if table.get(key) != value:
                        yield place, key, value


@pytest.mark.parametrize("name", EFFECTS)
def test_every_key_changes_the_run_or_is_refused(name):
    given = tables(EFFECTS[name])
    before, ignored = final(given), []
    for place, key, value in changes(given):
        other = deepcopy(given)
        table = other
        for part in place:
            table = table[part]
        table[key] = value
        try:
            after = final(other)
        except SceneError as error:
            named = (key, "effects.rolling.resistance: spheres roll only with friction")
            if not any(word in str(error) for word in named):
                ignored.append((place, key, value, f"refused without its name: {error}"))
            continue
        same = all(after[field] == before[field] for field in before.keys() & after.keys())
        if same and not any(may_be_alike(EFFECTS[name], key, value).values()):
            ignored.append((place, key, value))
    assert not ignored


@pytest.mark.parametrize("name", EFFECTS)
def test_every_option_changed_between_steps_changes_the_run_or_is_refused(name):
    given = tables(EFFECTS[name])
    before, ignored = final(given), []
    for place, key, value in changes(given):
        if len(place) != 2 or place[0] != "effects":
            continue
        try:
            after = final(given, (place[1], key, value))
        except SceneError as error:
            if key not in str(error):
                ignored.append((place, key, value, f"refused without its name: {error}"))
            continue
        if after == before and not any(may_be_alike(EFFECTS[name], key, value).values()):
            ignored.append((place, key, value))
    assert not ignored
