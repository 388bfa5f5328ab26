"""Mode `rewind`: the contacts of a step are found pair by pair and done in a few passes.

`operator` is the way of a drift; `contact_search` finds contacts, and `passes` selects and applies them;
`signs` counts what a user should know of: contacts that came late, spheres too fast for the step.
"""
