"""Hard spheres and walls: when they touch on straight paths, and how their velocities change."""
