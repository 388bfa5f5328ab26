"""What a run left, read back and shown.

In the order in which to read them:

- `frame`: the particles at one time
- `run`: `Run(folder)`: frames, diagnostics and scene of a run, also of one that is going on
- `scenery`: the box and the walls around the particles, as lines and polygons; `view_paraview.py` shows them in ParaView
- `curves`: what the diagnostics tell, as panels of curves
- `page`: all of it in one HTML file; `page.html` and the scripts `*.js` are its text
- `notebook`: the same page in a notebook, also of a simulation while it goes on

The page draws by WebGL itself, with no library: a sphere is a square whose pixels are shaded, so 32 000 of them are exact and
fast, and what a page holds is the run. k3d, which was tried, shows one quantity of each particle and no curves, and brings a
megabyte of script into each page.
"""
