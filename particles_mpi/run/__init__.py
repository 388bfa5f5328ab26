"""One run of the program, from its plan to its phase table.

- `job`: the run itself: its options, its steps, and what ends it
- `files`: its folder, and what it writes there: frames, rows of diagnostics, checkpoints
- `ending`: what it tells when it is done: phase table, `run.json`
- `console`: what a user sees of it; `forecast`: how long it will take
- `scene_file`: the scene that a command is given, the same on all ranks
- `scheduler`: the time limit of the job that it is in
- `doctor`: what is installed, and whether it works together
"""
