"""Mode `rewind`: the contacts of a step are found pair by pair and done in a few passes."""
