"""Mode `rewind`: the contacts of a step are found pair by pair and done in a few passes.

`operator` is the way of a drift; `contact_search` finds contacts, and `passes` selects and applies them.
"""
