"""What a scene file says, and the plan that follows from it.

`schema` is the scene file as a model, `values` and `messages` are what its keys may hold and how faults are told, `model` is the
base of its tables. `effect` has the kinds of effect, `effect_files` finds and loads their files, `active` sorts those that are
switched on. `plan` says what a run will do.
"""
