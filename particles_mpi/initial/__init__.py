"""The particles with which a scene starts, and the checks of their places."""
