"""Collision operators: when two spheres, or a sphere and a wall, touch on straight paths, and what happens then."""
