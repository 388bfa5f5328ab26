"""Scenes of rough spheres that tests share."""

from math import atan, cos, sin

from particles_mpi.scene.schema import Scene
from particles_mpi.simulation import Simulation

G = 9.81


def simulation(d, particles, effects, step=0.01, **more):
    """A simulation in open space, or what `more` says."""
    return Simulation(Scene(dimension=d, time={"step": step, "steps": 0}, particles=particles, effects=effects, **more))


def slope(d, tangent, friction, step=0.001, mode=None, effects=None, floor=None, output=None, **sphere):
    """A sphere of radius 0.5 and mass 2 on an incline, whose normal is the last axis; gravity points to the first one too."""
    angle, plane = atan(tangent), {"point": [0.0] * d, "normal": [0.0] * (d - 1) + [1.0]}
    down = [G * sin(angle)] + [0.0] * (d - 2) + [-G * cos(angle)]
    walls = {"planes": [plane], "restitution": 0.5, "friction": friction} | (floor or {})
    acting = {"uniform_gravity": {"acceleration": down}, "walls": walls} | (effects or {})
    if mode:
        acting["collisions"] = {"mode": mode, "restitution": 0.5, "friction": friction}
    ball = {"position": [[0.0] * (d - 1) + [0.5]], "radius": 0.5, "mass": 2.0} | sphere
    return simulation(d, [ball], acting, step, output=output or {})
