"""One run of the program, from its plan to its phase table.

- `job`: the run itself: its options, its steps, and what ends it
- `files`: the folder of the run, and what is written there: frames, rows of diagnostics, checkpoints
- `ending`: the end of a run: phase table, remarks, `run.json`
- `console`: prints plan, progress and tables; `forecast`: estimates how long the run takes
- `scene_file`: reads the scene file of a command, the same on all ranks
- `scheduler`: finds the time limit of the batch job in which the program runs
- `doctor`: checks what is installed, and whether it works together
"""
