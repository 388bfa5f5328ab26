"""Shows a run in ParaView: spheres of true radii, coloured by speed, in their box, ready to be played.

    paraview FOLDER/view_paraview.py

It reads the run beside which it lies. `pvbatch FOLDER/view_paraview.py FILE.png` makes a picture of the last frame.
"""

import csv
import os
import sys

from paraview import simple as pv

# As the run fills it in: its folder, box (lower, upper corner), walls (corners of each), and whether it is planar.
RUN = {'folder': '/work/main/.check-a7zn975q', 'box': [[0.0, 0.0, 0.0], [5.0, 5.0, 0.0]], 'walls': [], 'planar': True}
LATEST = (5, 13)  # the first ParaView that reads a trajectory.vtkhdf in which the number of particles changes
MANY = 20000  # particles: more are drawn as points shaded like spheres, which is faster


def folder():
    """Where this file lies; where the run was, if ParaView does not tell."""
    return os.path.dirname(os.path.abspath(__file__)) if "__file__" in globals() else RUN["folder"]


def frames():
    """The reader of the frames."""
    hdf, listing = (os.path.join(folder(), name) for name in ("trajectory.vtkhdf", "particles.pvd"))
    version = pv.GetParaViewVersion()
    if os.path.exists(hdf) and ((version.major, version.minor) >= LATEST or not os.path.exists(listing)):
        return pv.OpenDataFile(hdf)
    return pv.PVDReader(FileName=listing)


def largest_speed():
    """Of any particle at any time, as diagnostics.csv tells; 1 if it tells nothing."""
    try:
        with open(os.path.join(folder(), "diagnostics.csv"), newline="") as file:
            return max(float(row["max_speed"]) for row in csv.DictReader(file) if row["max_speed"]) or 1.0
    except (OSError, ValueError):
        return 1.0


def show_spheres(view, source, dot):
    """All particles with their radii, coloured by speed; those without radius as dots of radius `dot`."""
    data = source.GetDataInformation()
    radii = data.GetPointDataInformation().GetArrayInformation("radius")
    many, points = data.GetNumberOfPoints() > MANY, radii is None or radii.GetComponentRange(0)[1] == 0.0
    if many or points:
        shown = pv.Show(source, view)
        shown.SetRepresentationType("Point Gaussian")
        shown.ShaderPreset = "Sphere"
        shown.GaussianRadius = 1.0
        if points:
            shown.GaussianRadius = dot
        else:
            shown.ScaleByArray = 1
            shown.SetScaleArray = ["POINTS", "radius"]
            shown.UseScaleFunction = 0
    else:
        spheres = pv.Glyph(Input=source, GlyphType="Sphere", GlyphMode="All Points")
        spheres.ScaleArray = ["POINTS", "radius"]
        spheres.ScaleFactor = 2.0  # the sphere of ParaView has the diameter 1
        spheres.OrientationArray = ["POINTS", "No orientation array"]
        spheres.GlyphType.ThetaResolution = spheres.GlyphType.PhiResolution = 16
        shown = pv.Show(spheres, view)
    pv.ColorBy(shown, ("POINTS", "velocity", "Magnitude"))
    colors = pv.GetColorTransferFunction("velocity")
    colors.ApplyPreset("Viridis (matplotlib)", True)
    colors.RescaleTransferFunction(0.0, largest_speed())
    bar = pv.GetScalarBar(colors, view)
    bar.Title, bar.ComponentTitle = "speed", ""
    bar.TitleColor = bar.LabelColor = [0.1, 0.1, 0.15]
    bar.TitleFontSize = bar.LabelFontSize = 12
    bar.AutomaticLabelFormat, bar.LabelFormat, bar.RangeLabelFormat = 0, "%g", "%.3g"
    shown.SetScalarBarVisibility(view, True)


def show_surroundings(view):
    """The box of the scene, and the walls that are no faces of it."""
    if RUN["box"]:
        lower, upper = RUN["box"]
        box = pv.Box(Center=[0.5 * (a + b) for a, b in zip(lower, upper)])
        box.XLength, box.YLength, box.ZLength = (b - a for a, b in zip(lower, upper))
        shown = [pv.Show(box, view, "GeometryRepresentation")]
        shown[0].SetRepresentationType("Outline")
    for corners in RUN["walls"]:
        shown.append(pv.Show(pv.PolyLineSource(Points=[x for corner in corners for x in corner], Closed=1), view))
    for lines in shown if RUN["box"] else []:
        lines.AmbientColor = lines.DiffuseColor = [0.35, 0.4, 0.5]
        lines.LineWidth = 1.5


def extent(source):
    """(lower, upper) of the box, or where there is none of the particles at the first time and the last."""
    if RUN["box"]:
        return RUN["box"]
    found = []
    for time in (source.TimestepValues[0], source.TimestepValues[-1]):
        source.UpdatePipeline(time)
        found.append(source.GetDataInformation().GetBounds())
    return [[min(b[2 * k] for b in found) for k in range(3)], [max(b[2 * k + 1] for b in found) for k in range(3)]]


def look(view, lower, upper):
    """From a side and a little from above, so that all of the box is seen; a planar run from above, without perspective."""
    middle = [0.5 * (a + b) for a, b in zip(lower, upper)]
    size = sum((b - a) ** 2 for a, b in zip(lower, upper)) ** 0.5 or 1.0
    away = (0.0, 0.0, 1.0) if RUN["planar"] else (0.47, -0.81, 0.34)
    view.CameraFocalPoint = middle
    view.CameraPosition = [m + 2.15 * size * a for m, a in zip(middle, away)]
    view.CameraViewUp = [0.0, 1.0, 0.0] if RUN["planar"] else [0.0, 0.0, 1.0]
    view.CameraViewAngle = 30.0
    if RUN["planar"]:
        view.InteractionMode = "2D"
        view.CameraParallelProjection = 1
        view.CameraParallelScale = 0.55 * max(upper[1] - lower[1], 0.75 * (upper[0] - lower[0]))


def main():
    view = pv.GetActiveViewOrCreate("RenderView")
    view.UseColorPaletteForBackground = 0
    view.Background = [0.96, 0.97, 0.98]
    view.OrientationAxesLabelColor = [0.1, 0.1, 0.15]
    source = frames()
    lower, upper = extent(source)
    source.UpdatePipeline(source.TimestepValues[0])
    show_spheres(view, source, 0.01 * max(b - a for a, b in zip(lower, upper)))
    show_surroundings(view)
    look(view, lower, upper)
    text = pv.AnnotateTimeFilter(Input=source, Format="t = {time:g}")
    pv.Show(text, view).Color = [0.1, 0.1, 0.15]
    pv.SetActiveSource(source)
    animation = pv.GetAnimationScene()
    animation.UpdateAnimationUsingDataTimeSteps()
    animation.GoToFirst()
    pictures = [word for word in sys.argv[1:] if word.endswith(".png")]
    if pictures:
        animation.GoToLast()
        pv.SaveScreenshot(pictures[0], view, ImageResolution=[1200, 900])
    else:
        pv.Render(view)


main()
