"""The same bits on any number of ranks and on older processors: positions, velocities, diagnostics, counts; for every effect."""

import json
import os
import platform
import subprocess
import sys
from functools import cache

import numpy as np
import pytest
from conftest import ROOT, run_ranks
from numpy._core._multiarray_umath import __cpu_dispatch__

pytestmark = pytest.mark.parallel

BOX3 = {"lower": [0, 0, 0], "upper": [4, 4, 4]}
MIXED = {"radius": {"min": 0.05, "max": 0.15}, "mass": {"min": 0.1, "max": 0.5}, "velocity": {"speed": {"min": 0.1, "max": 3.0}}}
GRAVITY = {"acceleration": [0, 0, -9.80665]}
JAM = {"mass": {"min": 1.0, "max": 2.0}, "velocity": {"speed": 1.0}}

LATTICE = [[0.2 + 0.4 * (k % 4), 0.2 + 0.4 * (k // 4 % 4), 0.2 + 0.4 * (k // 16)] for k in (3 * n % 64 for n in range(48))]
CLOUD = np.random.default_rng(5).standard_normal((90, 3)).tolist()

SCENES = {
    "marbles": dict(
        dimension=3,
        box=BOX3,
        time={"step": 0.01, "steps": 60},
        particles=[{"count": 400, "position": "random", **MIXED}],
        effects={
            "uniform_gravity": GRAVITY,
            "friction": {"strength": 0.01},
            "collisions": {"damping": 0.01},
            "walls": {"damping": 0.01},
        },
    ),
    "dense periodic gas": dict(
        dimension=3,
        box={"lower": [0, 0, 0], "upper": [9.6, 9.6, 9.6], "periodic": True},
        time={"step": 0.03, "steps": 40},
        particles=[{"count": 512, "position": "lattice", "velocity": {"temperature": 1.0}, "radius": 0.5}],
        effects={"collisions": {"passes": 4}},
    ),
    "dense periodic gas, a collision of each in a step": dict(
        dimension=3,
        box={"lower": [0, 0, 0], "upper": [9.6, 9.6, 9.6], "periodic": True},
        time={"step": 0.1, "steps": 120},
        particles=[{"count": 512, "position": "lattice", "velocity": {"temperature": 1.0}, "radius": 0.5}],
        effects={"collisions": {}},
    ),
    "more contacts than passes, between walls": dict(
        dimension=2,
        box={"lower": [0, 0], "upper": [6, 6]},
        time={"step": 0.05, "steps": 40},
        particles=[{"count": 60, "position": "random", "velocity": {"speed": 6.0}, "radius": 0.25, "mass": 1.0}],
        effects={"collisions": {"passes": 1}, "walls": {}},
    ),
    "half periodic, drag, acceleration, fixed": dict(
        dimension=2,
        box={"lower": [0, 0], "upper": [10, 10], "periodic": [True, False]},
        time={"step": 0.01, "steps": 80},
        particles=[
            {"position": [[3, 3], [7, 6], [5, 5]], "radius": 0.8, "fixed": True},
            {"count": 60, "position": "random", "radius": 0.2, "velocity": {"speed": 2.0}, "drag": 0.3, "acceleration": [1, -2]},
        ],
        effects={"collisions": {"restitution": 0.8}, "walls": {"restitution": 0.5}, "drag": {}, "user_acceleration": {}},
    ),
    "a fixed disc that scatters many in a step": dict(
        dimension=2,
        box={"lower": [0, 0], "upper": [1, 1], "periodic": True},
        time={"step": 0.03, "steps": 20},
        particles=[
            {"position": [[0.5, 0.5]], "radius": 0.35, "fixed": True},
            {"count": 150, "position": "random", "velocity": {"speed": 1.0}},
        ],
        effects={"collisions": {}},
        output={"observables": True},
    ),
    "oblique planes, open space": dict(
        dimension=2,
        time={"step": 0.01, "steps": 200},
        particles=[
            {"position": [[0.5 * i, 4.0 + 0.5 * (i % 3)] for i in range(-10, 10)], "radius": 0.1, "velocity": {"speed": 1.0}}
        ],
        effects={
            "uniform_gravity": {"acceleration": [0, -9.81]},
            "collisions": {},
            "walls": {"planes": [{"point": [0, 0], "normal": [1, 2]}, {"point": [0, 0], "normal": [-1, 2], "restitution": 0.5}]},
        },
    ),
    "rack of touching discs": dict(
        dimension=2,
        time={"step": 0.002, "steps": 100},
        particles=[
            {"position": [[0.05 * 3**0.5 * r, 0.05 * (2 * c - r)] for r in range(5) for c in range(r + 1)], "radius": 0.05},
            {"position": [[-1.0, 0.0]], "velocity": [8.0, 0.0], "radius": 0.05},
        ],
        effects={"collisions": {"restitution": 0.95}},
    ),
    "walls and gravity only": dict(
        dimension=3,
        box=BOX3,
        time={"step": 0.01, "steps": 50},
        particles=[{"count": 100, "position": "random", **MIXED}],
        effects={"uniform_gravity": GRAVITY, "walls": {"restitution": 0.9}},
    ),
    "taylor": dict(
        dimension=2,
        box={"lower": [0, 0], "upper": [4, 4]},
        time={"step": 0.01, "steps": 50, "integrator": "taylor"},
        particles=[{"count": 50, "position": "random", "radius": 0.1, "velocity": {"speed": 1.0}}],
        effects={"drag": {"rate": 0.2}, "uniform_gravity": {"acceleration": [0, -1]}, "collisions": {}, "walls": {}},
    ),
    "more ranks than particles": dict(
        dimension=1,
        time={"step": 0.05, "steps": 60},
        particles=[{"position": [[0.0], [1.0], [2.0]], "velocity": [[1.0], [0.0], [-1.0]], "radius": 0.1}],
        effects={"collisions": {}},
    ),
    "cluster, fixed and without mass": dict(
        dimension=3,
        G=1.0,
        time={"step": 0.01, "steps": 20},
        particles=[
            {"position": [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]], "mass": 2.0, "fixed": True},
            {"position": CLOUD[:60], "velocity": {"speed": 0.3}, "mass": {"min": 0.01, "max": 0.1}},
            {"position": CLOUD[60:], "velocity": {"speed": 0.3}, "mass": 0.0},
        ],
        effects={"mutual_gravity": {"softening": 0.05}},
    ),
    "colliding cluster": dict(
        dimension=2,
        G=1.0,
        time={"step": 0.01, "steps": 60},
        particles=[
            {"position": [[0.7 * (k % 8), 0.7 * (k // 8)] for k in range(60)], "radius": 0.2, "mass": {"min": 0.5, "max": 1.0}}
        ],
        effects={"mutual_gravity": {}, "collisions": {"restitution": 0.5}},
    ),
    "order4": dict(
        dimension=2,
        G=1.0,
        time={"step": 0.01, "steps": 20, "integrator": "order4"},
        particles=[{"position": [[1.0, 0.0], [-1.0, 0.1], [0.0, 2.0], [0.3, -2.0]], "velocity": {"speed": 0.5}, "mass": 1.0}],
        effects={"mutual_gravity": {}},
    ),
    "adaptive": dict(
        dimension=2,
        G=1.0,
        time={"step": 0.1, "steps": 2, "integrator": "adaptive"},
        particles=[{"position": [[1.0, 3.0], [-2.0, -1.0], [1.0, -1.0]], "mass": [3.0, 4.0, 5.0]}],
        effects={"mutual_gravity": {}},
    ),
    "adaptive, far from the origin": dict(
        dimension=2,
        G=1.0,
        time={"step": 0.004, "steps": 2, "integrator": "adaptive"},
        particles=[
            {"position": [[100.0, 100.0], [100.01, 100.0], [103.0, 99.0]], "velocity": [[0, -5], [0, 5], [0, 0]], "mass": 0.5}
        ],
        effects={"mutual_gravity": {}},
    ),
    "cluster by tree, fixed and without mass": dict(
        dimension=3,
        G=1.0,
        time={"step": 0.01, "steps": 2},
        particles=[
            {"count": 2000, "position": {"plummer": 1.0}, "velocity": "equilibrium", "mass": 0.001},
            {"position": CLOUD[:60], "mass": {"min": 0.0, "max": 0.1}, "fixed": True},
            {"position": [*CLOUD[60:], *[CLOUD[60]] * 200], "velocity": {"speed": 0.3}, "mass": 0.0},
        ],
        effects={"mutual_gravity": {"softening": 0.05, "method": "tree", "opening_angle": 0.7}},
    ),
    "cluster by tree of monopoles": dict(
        dimension=3,
        G=1.0,
        time={"step": 0.01, "steps": 2},
        particles=[
            {"count": 2000, "position": {"plummer": 1.0}, "velocity": "equilibrium", "mass": 0.001},
            {"position": CLOUD, "mass": {"min": 0.0, "max": 0.1}, "fixed": True},
        ],
        effects={"mutual_gravity": {"method": "tree", "opening_angle": 0.8, "multipole": "monopole"}},
    ),
    "discs that come to rest": dict(
        dimension=2,
        box={"lower": [0, 0], "upper": [4, 20]},
        time={"step": 0.01, "steps": 150},
        particles=[{"count": 40, "position": "random", "radius": {"min": 0.2, "max": 0.4}, "mass": {"min": 0.1, "max": 5.0}}],
        effects={
            "uniform_gravity": {"acceleration": [0.5, -9.81]},
            "collisions": {"restitution": 0.3},
            "walls": {"restitution": 0.3},
        },
    ),
    "balls that come to rest in a wedge": dict(
        dimension=2,
        time={"step": 0.01, "steps": 150},
        particles=[{"position": [[0.3 * (k % 5) - 0.6, 1.5 + 0.1 * k] for k in range(20)], "radius": {"min": 0.05, "max": 0.3}}],
        effects={
            "uniform_gravity": {"acceleration": [0.0, -9.81]},
            "walls": {
                "restitution": 0.3,
                "planes": [{"point": [0, 0], "normal": [1, 0.8]}, {"point": [0, 0], "normal": [-1, 0.7]}],
            },
        },
    ),
    "columns of very different masses": dict(
        dimension=2,
        time={"step": 0.01, "steps": 40},
        box={"lower": [0.0, 0.0], "upper": [4.0, 4.0]},
        particles=[{"position": [[0.5 + k // 4, 0.3 + 0.6 * (k % 4)] for k in range(16)], "radius": 0.3,
                    "mass": [[1.0, 1e6, 1e2, 1e8][(k + k // 4) % 4] for k in range(16)]},
                   {"position": [[3.9, 2.0]], "velocity": [-9.0, 0.0], "radius": 0.05, "mass": 1e3}],
        effects={
            "uniform_gravity": {"acceleration": [0.5, -9.81]},
            "collisions": {"restitution": 0.5},
            "walls": {"restitution": 0.5},
        },
    ),
    "balls that collide on a floor, and lean on a wall in the end": dict(
        dimension=3,
        time={"step": 0.01, "steps": 250},
        particles=[
            {"position": [[0.5 * i + 0.1 * j, 0.3 * j, 0.1] for i in range(6) for j in range(5)], "radius": 0.1,
             "velocity": {"speed": {"min": 0.1, "max": 1.0}}},
            {"position": [[1.2, 0.45, 0.35], [2.2, 0.75, 0.35]], "radius": {"min": 0.05, "max": 0.1}},
        ],
        effects={
            "uniform_gravity": {"acceleration": [-6.0, 0.1, -9.81]},
            "collisions": {"restitution": 0.6},
            "walls": {
                "restitution": 0.4,
                "planes": [
                    {"point": [0, 0, 0], "normal": [0, 0, 1]}, {"point": [-0.2, 0, 0], "normal": [1, 0, 0]},
                    {"point": [0, -0.2, 0], "normal": [0, 1, 0.2]}, {"point": [0, 1.6, 0], "normal": [0, -1, 0]},
                ],
            },
        },
    ),
    "a heap that collapses in crowds": dict(
        dimension=3,
        box={"lower": [0, 0, 0], "upper": [0.6, 0.6, 1.6]},
        time={"step": 0.005, "steps": 200},
        particles=[{"count": 120, "position": "random", "radius": {"min": 0.045, "max": 0.05}}],
        effects={"uniform_gravity": GRAVITY, "collisions": {"restitution": 0.5}, "walls": {"restitution": 0.5}},
    ),
    "colliding discs by quadtree": dict(
        dimension=2,
        G=1.0,
        box={"lower": [0, 0], "upper": [40, 30]},
        time={"step": 0.01, "steps": 4},
        particles=[{"count": 1500, "position": "random", "radius": {"min": 0.1, "max": 0.2}, "velocity": {"speed": 3.0}}],
        effects={"mutual_gravity": {"method": "auto", "accuracy": 0.01}, "collisions": {}, "walls": {}},
    ),
    "each its own acceleration and drag, damping, friction": dict(
        dimension=2,
        box={"lower": [0, 0], "upper": [10, 10], "periodic": [True, False]},
        time={"step": 0.01, "steps": 60},
        particles=[
            {"position": [[3, 3], [7, 6]], "radius": 0.8, "fixed": True, "acceleration": [9, 9]},
            *[
                {"count": 12, "position": "random", "radius": 0.2, "mass": {"min": 0.2, "max": 2.0}, "velocity": {"speed": 3.0},
                 "drag": 0.2 * k, "acceleration": [3.0 - k, 2.0 * k - 5.0]}
                for k in range(6)
            ],
        ],
        effects={"collisions": {"damping": 0.2}, "walls": {"damping": 0.3}, "drag": {}, "friction": {"strength": 0.3},
                 "user_acceleration": {}},
    ),
    "masses that attract, with damping and drag": dict(
        dimension=3,
        G=0.5,
        box={"lower": [0, 0, 0], "upper": [5, 5, 5]},
        time={"step": 0.01, "steps": 40},
        particles=[
            {"position": [[2.5, 2.5, 2.5]], "radius": 0.5, "mass": 5.0, "fixed": True},
            {"count": 90, "position": "random", "radius": {"min": 0.15, "max": 0.3}, "mass": {"min": 0.1, "max": 1.0},
             "velocity": {"speed": 3.0}, "drag": 0.5},
        ],
        effects={"mutual_gravity": {}, "collisions": {"damping": 0.1}, "walls": {"damping": 0.1}, "drag": {}},
    ),
    "rough gas, fixed, walls": dict(
        dimension=3,
        box=BOX3 | {"periodic": [True, False, False]},
        time={"step": 0.01, "steps": 60},
        particles=[
            {"position": [[1, 1, 1], [3, 3, 3]], "radius": 0.5, "fixed": True},
            {"count": 200, "position": "random", **MIXED, "spin": {"temperature": 0.5}},
        ],
        effects={
            "uniform_gravity": GRAVITY,
            "drag": {"rate": 0.1},
            "collisions": {"restitution": 0.9, "friction": 0.3, "tangential_restitution": 0.5},
            "walls": {"tangential_restitution": 0.8},
        },
    ),
    "rough balls on an incline": dict(
        dimension=3,
        time={"step": 0.01, "steps": 100},
        particles=[{"position": [[0.3 * i, 0.3 * j, 0.1 + 0.01 * j] for i in range(5) for j in range(5)], "radius": 0.1}],
        effects={
            "uniform_gravity": {"acceleration": [3.0, 1.0, -9.0]},
            "walls": {"planes": [{"point": [0, 0, 0], "normal": [0, 0, 1]}], "restitution": 0.4, "friction": 0.1},
        },
    ),
    "elastic points and spheres that attract one another, on rough walls": dict(
        dimension=3,
        G=0.01,
        box={"lower": [0, 0, 0], "upper": [1.6, 1.6, 1.6]},
        time={"step": 0.1, "steps": 6},
        particles=[
            {"position": LATTICE[:46], "mass": 1000.0, "velocity": {"temperature": 1.0}, "moment_of_inertia": 0.01},
            {"position": LATTICE[46:48], "radius": 0.2, "spin": [0.5, -0.4, 1.0]},
        ],
        effects={
            "mutual_gravity": {"softening": 0.05},
            "collisions": {},
            "walls": {"restitution": 0.9, "friction": 0.1},
        },
    ),
    "no particles": dict(
        dimension=2, box={"lower": [0, 0], "upper": [4, 4]}, time={"step": 0.05, "steps": 3},
        particles=[{"count": 0, "position": "random", "radius": 0.1}], effects={"collisions": {}, "walls": {}},
    ),
}  # fmt: skip
HEAP, DISCS = "a heap that collapses in crowds", "discs that come to rest"
for smooth, rough, surfaces, steps, count, top in (  # friction takes longer than all else: they are fewer, and fall less deep
    (DISCS, f"rough {DISCS}", {"collisions": 0.4, "walls": 0.5}, 70, 16, [3, 6]),
    (HEAP, "a rough heap", {"collisions": 0.3, "walls": 0.3}, 105, 40, [0.4, 0.4, 1.0]),
):
    effects = SCENES[smooth]["effects"]
    with_friction = {name: effects[name] | {"friction": mu} for name, mu in surfaces.items()}
    more = {"rolling": {"resistance": 0.01}} if smooth == DISCS else {}
    box, time = {"lower": [0] * len(top), "upper": top}, SCENES[smooth]["time"] | {"steps": steps}
    particles = [population | {"count": count} for population in SCENES[smooth]["particles"]]
    SCENES[rough] = SCENES[smooth] | {"box": box, "time": time, "particles": particles, "effects": effects | with_friction | more}
SCENES["a sphere that pushes another one, which drag holds back"] = dict(
    dimension=2,
    time={"step": 0.05, "steps": 60},
    particles=[
        {"position": [[0.2, 0.0], [-0.1, 0.0]], "radius": 0.1, "mass": [1.0, 2.0], "drag": [2.0, 0.3],
         "acceleration": [[0.0, 0.0], [1.0, 0.0]]},
    ],
    effects={"user_acceleration": {}, "drag": {}, "collisions": {"restitution": 0.5}},
)  # fmt: skip
IN_ORDER, IN_WINDOWS = ": in order of time", ": in windows"
EVENTS = (
    "balls that collide on a floor, and lean on a wall in the end",
    "discs that come to rest",
    "a heap that collapses in crowds",
    "colliding cluster",
    "dense periodic gas",
    "each its own acceleration and drag, damping, friction",
    "half periodic, drag, acceleration, fixed",
    "masses that attract, with damping and drag",
    "oblique planes, open space",
    "rack of touching discs",
    "rough gas, fixed, walls",
    "rough discs that come to rest",
    "a rough heap",
)
for name in EVENTS:
    given = SCENES[name]["effects"]["collisions"]
    given = {key: value for key, value in given.items() if key != "passes"}
    collisions = ({} if "damping" in given else {"restitution": 0.9}) | given | {"mode": "event"}
    SCENES[name + IN_ORDER] = SCENES[name] | {"effects": SCENES[name]["effects"] | {"collisions": collisions}}


SCENES |= {
    "rough discs that spin in corners, among walls alone": dict(
        dimension=2,
        box={"lower": [0, 0], "upper": [3.0, 3.0]},
        time={"step": 0.01, "steps": 120},
        particles=[
            {"position": [[0.1, 0.1], [2.9, 0.1], [0.1, 0.5], [1.0, 0.1]], "radius": 0.1, "spin": [20.0, -20.0, 5.0, 9.0]},
            {"count": 6, "position": "random", "velocity": {"speed": 2.0}, "radius": 0.1, "spin": {"temperature": 1.0}},
        ],
        effects={"uniform_gravity": {"acceleration": [-1.0, -9.81]}, "walls": {"restitution": 0.4, "friction": 0.3}},
    ),
    "spheres that fill a box": dict(
        dimension=2,
        box={"lower": [0, 0], "upper": [2.0, 2.0]},
        time={"step": 0.01, "steps": 20},
        particles=[{"position": [[0.2 + 0.4 * i, 0.2 + 0.4 * k] for i in range(5) for k in range(5)], "radius": 0.2} | JAM],
        effects={"collisions": {"mode": "event"}, "walls": {}},
    ),
    "cold dense gas, with observables": dict(
        dimension=3,
        box={"lower": [0, 0, 0], "upper": [9.6, 9.6, 9.6], "periodic": True},
        time={"step": 0.2, "steps": 8},
        particles=[{"count": 700, "position": "lattice", "velocity": {"temperature": 1.0}, "radius": {"min": 0.3, "max": 0.5}}],
        effects={"collisions": {"mode": "event", "restitution": 0.7, "contact_duration": 0.001}},
        output={"observables": True},
    ),
    "discs that fall onto others, and rattle until they are solved directly": dict(
        dimension=2,
        seed=1,
        box={"lower": [0, 0], "upper": [1.4, 2.8]},
        time={"step": 0.01, "steps": 90},
        particles=[{"count": 100, "radius": 0.05, "position": "random", "velocity": {"speed": 1.0}}],
        effects={
            "uniform_gravity": {"acceleration": [0, -9.81]},
            "walls": {"restitution": 0.8},
            "collisions": {"restitution": 0.5},
        },
    ),
    "discs without room that forces press onto walls that take no energy": dict(
        dimension=2,
        box={"lower": [0, 0], "upper": [0.6, 1.0]},
        time={"step": 0.0025, "steps": 60},
        particles=[
            {
                "position": [[0.05 + 0.1 * i, 0.05 + 0.1001 * k] for k in range(5) for i in range(6)],
                "radius": 0.05,
                "velocity": {"speed": 0.05},
            }
        ],
        effects={
            "collisions": {"mode": "event", "restitution": 0.5, "allow_overlap": True},
            "walls": {},
            "uniform_gravity": {"acceleration": [0.0, -9.8]},
        },
    ),
    "discs that collapse": dict(
        dimension=2,
        box={"lower": [0, 0], "upper": [16.0, 16.0]},
        time={"step": 0.2, "steps": 40},
        particles=[{"count": 170, "position": "lattice", "velocity": {"temperature": 1.0}, "radius": 0.5}],
        effects={"collisions": {"mode": "event", "restitution": 0.1}, "walls": {"restitution": 0.1}},
    ),
    "chain of touching discs": dict(
        dimension=2,
        time={"step": 0.5, "steps": 6},
        particles=[
            {"position": [[float(k), 0.0] for k in range(50)], "radius": 0.5},
            {"position": [[-3.0, 0.0], [25.2, 4.0]], "velocity": [[2.0, 0.0], [0.0, -1.0]], "radius": 0.5},
        ],
        effects={"collisions": {"mode": "event"}},
    ),
    "rods on a ring": dict(
        dimension=1,
        box={"lower": [0.0], "upper": [100.0], "periodic": True},
        time={"step": 1.0, "steps": 5},
        particles=[{"position": [[1.25 * k] for k in range(80)], "velocity": {"temperature": 1.0}, "radius": 0.5}],
        effects={"collisions": {"mode": "event"}},
    ),
}
PLANE = [[0.35 * i + 0.05 * (j % 3), 0.4 * j, 2.0] for i in range(6) for j in range(6)]
SCENES["points that attract one another, and spheres, with losses"] = dict(
    dimension=3,
    G=1.0,
    time={"step": 0.02, "steps": 30},
    particles=[
        {"position": PLANE, "mass": 0.1},
        {"position": [[0.9, 0.9, 3.0], [1.1, 0.9, 3.0]], "velocity": [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], "radius": 0.05},
    ],
    effects={"mutual_gravity": {"softening": 0.05}, "collisions": {"restitution": 0.5}},
)
LARGE = "fluid large enough to divide"
SCENES[LARGE] = dict(
    dimension=3,
    seed=3,  # one of those (five of six) in which no row of contacts crosses a border in no time, which costs a dozen windows
    box={"lower": [0, 0, 0], "upper": [28, 28, 28], "periodic": True},
    time={"step": 0.05, "steps": 3},
    particles=[{"count": 12000, "position": "lattice", "velocity": {"temperature": 1.0}, "radius": 0.5}],
    effects={"collisions": {"mode": "event"}},
)
SCENES["cluster, in blocks"] = SCENES["cluster, fixed and without mass"] | {"few": 0}
SCENES["more than make one sum attract one another, and collide"] = dict(
    dimension=2,
    G=1.0,
    time={"step": 0.01, "steps": 20},
    particles=[
        {"position": [[0.5 * (k % 17), 0.5 * (k // 17)] for k in range(285)], "radius": 0.2, "mass": {"min": 0.0, "max": 1.0}},
        {"position": [[-9.0, 0.0], [17.0, 4.0]], "mass": 20.0, "fixed": True},
    ],
    effects={"mutual_gravity": {}, "collisions": {"restitution": 0.5}},
)
SCENES["more than make one sum attract one another, in blocks"] = SCENES["cluster by tree of monopoles"] | {
    "particles": [
        {"count": 500, "position": {"plummer": 1.0}, "velocity": "equilibrium", "mass": 0.001},
        {"position": CLOUD, "mass": {"min": 0.0, "max": 0.1}, "fixed": True},
    ],
    "effects": {"mutual_gravity": {}},
    "few": 0,
}
GRAINS = [[0.15 + 0.2 * i, 0.15 + 0.2 * j, 0.1 + 0.2 * k] for i in range(4) for j in range(4) for k in range(3)]
SCENES["rough columns that stand still, and are hit"] = dict(
    dimension=3,
    box={"lower": [0, 0, 0], "upper": [0.9, 0.9, 3.0]},
    time={"step": 0.01, "steps": 95},
    particles=[{"position": GRAINS, "radius": 0.1}, {"position": [[0.5, 0.4, 2.85]], "radius": 0.1}],
    effects={
        "uniform_gravity": GRAVITY,
        "collisions": {"restitution": 0.5, "friction": 0.4},
        "walls": {"restitution": 0.5, "friction": 0.4},
        "rolling": {"resistance": 0.002},
    },
    large=True,
)
BOUNCING = "elastic discs that attract one another, among fixed ones and walls"
SCENES[BOUNCING] = dict(
    dimension=2,
    G=1.0,
    box={"lower": [0, 0], "upper": [4, 4]},
    time={"step": 0.02, "steps": 40},
    particles=[
        {"position": [[1.0, 1.0], [3.0, 2.0], [2.0, 3.2]], "radius": 0.3, "mass": 2.0, "fixed": True},
        {"count": 100, "position": "random", "radius": 0.08, "velocity": {"speed": 1.0}, "mass": {"min": 0.0, "max": 0.3}},
    ],
    effects={"mutual_gravity": {}, "collisions": {"mode": "event"}, "walls": {}},
)
SQUEEZED = [[1.5 + 2.2 * (k % 6), 1.0 + 2.0 * (k // 6)] for k in range(42)]
SCENES["light discs that heavy ones squeeze out, further than candidates reach"] = dict(
    dimension=2,
    box={"lower": [0, 0], "upper": [16, 16]},
    time={"step": 0.03, "steps": 12},
    particles=[
        {"position": [[x - 0.45, y] for x, y in SQUEEZED], "velocity": [3.0, 0.0], "radius": 0.35, "mass": 100.0},
        {"position": [[x + 0.45, y] for x, y in SQUEEZED], "velocity": [-3.0, 0.0], "radius": 0.35, "mass": 100.0},
        {"position": [[x, y + 0.02 + 0.003 * (k % 7)] for k, (x, y) in enumerate(SQUEEZED)], "radius": 0.05, "mass": 1e-4},
    ],
    effects={"collisions": {}, "walls": {}},
)  # a drift is undone for it, on two ranks and on three
TURNING = {"restitution": 0.9, "tangential_restitution": 1.0}
SCENES["rough discs that attract one another, with drag"] = SCENES[BOUNCING] | {
    "effects": {"mutual_gravity": {}, "collisions": TURNING | {"mode": "event"}, "walls": TURNING, "drag": {"rate": 0.1}}
}
SCENES["super balls that attract one another"] = SCENES[BOUNCING] | {
    "effects": {"mutual_gravity": {}, "collisions": {"tangential_restitution": 1.0}, "walls": {"tangential_restitution": 1.0}}
}
SCENES[f"{BOUNCING}, by passes"] = SCENES[BOUNCING] | {"effects": {"mutual_gravity": {}, "collisions": {}, "walls": {}}}
ROW = [[-0.201 * (10 - k), 0.0] for k in range(11)]
SCENES["a row of ever lighter discs that throws the last one at a far disc"] = dict(
    dimension=2,
    time={"step": 0.01, "steps": 3},
    particles=[
        {"position": ROW[:1], "velocity": [1.0, 0.0], "radius": 0.1, "mass": 1e10},
        {"position": ROW[1:], "radius": 0.1, "mass": [100.0 ** (4 - k) for k in range(10)]},
        {"position": [[6.0 + 0.25 * k, 1.5 * (k % 2) - 1.5 * (k > 0) * (k % 2 == 0)] for k in range(11)], "radius": 0.1},
    ],
    effects={"collisions": {"mode": "event"}},
)  # which it would, in the first window, come to before any rank knew of both
BOTH = f"{HEAP}, solved as a large one, in windows"  # each by itself is there, too
WINDOWS = [name for name in SCENES if SCENES[name]["effects"].get("collisions", {}).get("mode") == "event" and name != LARGE]
SCENES |= {name + IN_WINDOWS: SCENES[name] | {"windows": True, "few": 0} for name in WINDOWS}
SCENES |= {
    f"{HEAP}, solved as a large one": SCENES[HEAP] | {"large": True},
    "a rough heap, solved as a large one": SCENES["a rough heap"] | {"large": True},
    BOTH: SCENES[HEAP + IN_ORDER] | {"large": True, "windows": True, "few": 0},
}
MANY = (4, 7, 8)  # ranks, only with --all
LONG = 40  # steps


def most_ranks(name):
    """On how many ranks a scene runs without --all: three, if it is short; one less if its twin in windows is there too."""
    if name == BOTH:
        return 1
    long, twin = SCENES[name]["time"]["steps"] > LONG, name.endswith(IN_ORDER)
    return 3 - long - twin


def cases(ranks, names):
    """Parameters (name, ranks) of tests of these scenes; what takes long is marked so."""
    return [pytest.param(name, r, marks=[pytest.mark.slow] if r > most_ranks(name) else []) for r in ranks for name in names]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """results(name, ranks): the arrays of a scene on a number of ranks. The first call runs all scenes of its group.

    On one rank there are no windows, so that scenes that are forced into them are compared with the run of the others.
    """
    folder = tmp_path_factory.mktemp("bits")

    def group(name):
        return "large" if name == LARGE else f"up to {most_ranks(name)}"

    for one in {group(name) for name in SCENES}:
        scenes = {name: scene for name, scene in SCENES.items() if group(name) == one}
        (folder / one).write_text(json.dumps(scenes))
        alone = {name: scene for name, scene in scenes.items() if not name.endswith(IN_WINDOWS)}
        (folder / f"{one} on 1").write_text(json.dumps(alone))

    @cache
    def run(one, ranks):
        file = folder / (f"{one} on 1" if ranks == 1 else one)
        done = run_ranks(ranks, "tests/parallel/final_state.py", file, folder, timeout=300)
        assert done.returncode == 0, done.stderr[-2000:]

    @cache
    def load(name, ranks):
        if ranks == 1:
            name = name.removesuffix(IN_WINDOWS)
        run(group(name), ranks)
        return dict(np.load(folder / f"{name}.{ranks}.npz"))

    return load


@pytest.mark.parametrize(("name", "ranks"), cases((2, 3, *MANY), SCENES))
def test_same_bits(results, name, ranks):
    one, many = results(name, 1), results(name, ranks)
    different = [key for key in one if key not in ("traffic", "windows") and one[key].tobytes() != many[key].tobytes()]
    assert not different


PROCESSORS = {  # what numba, numpy, OpenBLAS and the C library are told
    "of 2013, with AVX2": ("x86-64-v3", "Haswell", {name for name in __cpu_dispatch__ if "512" in name or "V4" in name}, ""),
    "of 2008, without FMA": ("x86-64-v2", "Nehalem", set(__cpu_dispatch__) - {"SSSE3", "SSE41", "POPCNT", "SSE42"}, "-AVX2,-FMA"),
}


@pytest.mark.slow
@pytest.mark.timeout(2500)  # three minutes alone; beside ranks that wait for one another, several times as long
@pytest.mark.skipif(platform.machine() != "x86_64", reason="processors of another architecture")
@pytest.mark.parametrize("processor", PROCESSORS)
def test_same_bits_on_an_older_processor(results, processor, tmp_path):
    """All kernels are compiled for it, with shorter vectors, and libraries take the branches that they have for it."""
    name, blas, missing, hardware = PROCESSORS[processor]
    told = {"NUMBA_CPU_NAME": name, "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(tmp_path), "OPENBLAS_CORETYPE": blas}
    told |= {
        "NPY_DISABLE_CPU_FEATURES": " ".join(missing),
        "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={hardware}",
        "PYTHONPATH": str(ROOT),
    }
    scenes = {name: scene for name, scene in SCENES.items() if not {"windows", "large"} & scene.keys()}  # those need ranks
    (tmp_path / "scenes.json").write_text(json.dumps(scenes))
    command = [sys.executable, ROOT / "tests/parallel/final_state.py", tmp_path / "scenes.json", tmp_path]
    subprocess.run(command, env=os.environ | told, cwd=ROOT, check=True, timeout=2400)
    different = []
    for scene in scenes:
        here, there = results(scene, 1), dict(np.load(tmp_path / f"{scene}.1.npz"))
        different += [(scene, key) for key in here if here[key].tobytes() != there[key].tobytes()]
    assert not different


@pytest.mark.parametrize(("name", "ranks"), cases((2, 3, 8), [name + IN_WINDOWS for name in WINDOWS]))
def test_windows_were_verified(results, name, ranks):
    """Forced to, ranks divide even small scenes; where contacts follow one another in no time they give up, and say so."""
    windows, redone = results(name, ranks)["windows"]
    assert windows > 0 and redone < windows


@pytest.mark.parametrize(("name", "ranks"), cases((2, 3, 8), WINDOWS))
def test_few_are_not_divided(results, name, ranks):
    """Too few particles to divide, unless ranks must."""
    assert not results(name, ranks)["windows"].any()


@pytest.mark.parametrize(
    ("ranks", "divided"),
    [
        (1, False),
        (2, True),
        (3, True),
        pytest.param(4, True, marks=pytest.mark.slow),
        pytest.param(8, False, marks=pytest.mark.slow),
    ],
)
def test_space_is_divided_where_that_pays(results, ranks, divided):
    """2000 particles a rank at least; and few windows are redone."""
    windows, redone = results(LARGE, ranks)["windows"]
    assert (windows > 0) == divided
    assert redone <= 0.1 * windows


@pytest.mark.parametrize(("name", "ranks"), cases((2, 3, 8), SCENES))
def test_only_pairs_are_worth_a_message(results, name, ranks):
    """Scenes with collisions really are decomposed; without pairs no ghost, no migration, no message."""
    traffic, particles = results(name, ranks)["traffic"], len(results(name, ranks)["id"])
    if "collisions" in SCENES[name]["effects"] and particles:
        assert results(name, 1)["counts"][0] > 0
        assert traffic[0] > 0
    elif "mutual_gravity" in SCENES[name]["effects"]:
        assert traffic[0] > 0 and traffic[1] == 0
    else:
        assert not traffic.any()
