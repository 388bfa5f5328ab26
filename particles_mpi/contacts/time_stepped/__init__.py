"""Mode `rewind`: the contacts of a step are found pair by pair and done in a few passes.

`operator` is the way of a drift; `contact_search` finds contacts, and `passes` selects and applies them;
`signs` counts what a user should know of: contacts that came late, spheres too fast for the step.

The way of one drift (`operator.Rewind.drift`): `Neighbourhood.prepare` sees that the candidate pairs hold for this step. Then, in
each pass, `find_contacts` and `find_wall_hits` compute the time of contact on the present segments; `select_contacts` chooses
for each particle the earliest; ranks exchange what they chose; `apply_contacts` lets those contacts happen that both partners
chose, and both begin a new segment; ranks exchange those, and `Neighbourhood.follow` finds who is in the way of them. When no
contact is left, all move to the end.
"""
