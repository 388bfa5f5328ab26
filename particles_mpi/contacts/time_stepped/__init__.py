"""Mode `rewind`: the contacts of a step are found pair by pair and carried out in a few passes.

`operator` is the course of a drift; `contact_search` finds contacts, and `passes` selects and applies them; `signs` counts what a
user should know: contacts that came late, and spheres that are too fast for the step.

The course of one drift (`operator.Rewind.drift`): `Neighbourhood.prepare` makes sure that the candidate pairs hold for this step.
Then, in each pass, `find_contacts` and `find_wall_hits` compute the time of contact on the present segments. `select_contacts`
chooses the earliest one of each particle, and ranks exchange the choices. `apply_contacts` carries out those contacts that both
partners chose, and both begin a new segment. Ranks exchange these, and `Neighbourhood.follow` finds candidates near them. When no
contact is left, all particles move to the end of the drift.
"""
