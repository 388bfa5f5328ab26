"""What a scene file says, and the plan that follows from it.

`schema` is the scene file as a model; `model` is the base of its tables, what their keys may hold, and how faults are told.
`effect` has the kinds of effect and loads their files, `active` sorts those that are switched on. `plan` says what a run will do.
"""
