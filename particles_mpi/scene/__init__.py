"""The scene file as a validated model, the kinds of effect, and the plan that follows from a scene.

- `schema`: the scene file; `population`: its tables `[[particles]]`; `model`: the base class of all tables, and messages about
  their faults
- `effect`: the kinds of effect; `effect_files`: loads the files of effects; `calls`: calls their methods and reports errors in
  them
- `losses`: the keys for restitution, damping and friction; `active`: the effects that are switched on, sorted by kind
- `plan`: what a run will do; `memory`: how much memory it will need
"""
