"""The results of a run, read back and shown.

In the order in which to read them:

- `frame`: the particles at one time
- `run`: `Run(folder)`: frames, diagnostics and scene of a run, also of one that is still going on
- `scenery`: the box and the walls around the particles, as lines and polygons; `view_paraview.py` shows them in ParaView
- `curves`: the columns of the diagnostics, as panels of curves
- `page`: all of it in one HTML file; `page.html` and the scripts `*.js` are its text
- `notebook`: the same page in a notebook, also of a simulation while it goes on

The page draws by WebGL without a library. A sphere is a square whose pixels are shaded, so 32 000 of them are exact and fast, and
nearly all of a page is the data of the run. k3d, which was tried, shows one quantity of each particle and no curves, and adds a
megabyte of script to each page.
"""
