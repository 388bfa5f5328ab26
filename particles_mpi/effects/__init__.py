"""One file an effect. `[effects.NAME]` in a scene loads `NAME.py`; an effect that no scene names is never imported.

Each file holds `Options` (the keys of its table) and `Effect` (what it does), with

- `role`: "force" adds to an acceleration, "dissipation" acts on velocities in the kicks, "event" acts during the drift;
- `fields`: the per-particle fields it needs beyond position, velocity, radius and mass;
- `formula`: its law in one line, for the plan.
"""
