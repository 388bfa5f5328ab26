"""What a scene file says, and the plan that follows from it.

`schema` is the scene file as a model, `population` its tables `[[particles]]`; `model` is the base of all tables, what their
keys may hold, and how faults are told.
`effect` has the kinds of effect, `effect_files` loads them, `calls` calls what is in them, `losses` says what contacts take, and
`active` sorts those that are switched on. `plan` says what a run will do, and `memory` what it needs for that.
"""
