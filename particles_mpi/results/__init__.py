"""What a run left, read back and shown.

In the order in which to read them:

- `run`: `Run(folder)`: frames, diagnostics and scene of a run, also of one that is going on
"""
