"""Show a run in ParaView: a body with its slip or temperature, and the stress in a section.

As a macro (*Macros > Import new macro...*): open ``fields.vtkhdf``, press Apply, then its button.
From a terminal: ``pvbatch docs/paraview_macro.py out/hip/fields.vtkhdf hip.png [FIELD]``.
"""

import sys

from paraview import servermanager
from paraview import simple as pv

FIELDS = ("_slip", "temperature_peak", "displacement")  # of the body: the first that is there
SECTIONS = ("von_mises", "temperature_peak", "displacement")
UNITS = {**dict.fromkeys(("_pressure", "_shear", "von_mises"), "MPa"), "temperature_peak": "°C"}
LARGEST = 0.05  # displacement drawn, of the size of the model


def first(names, ends):
    """The last name that ends as one of some do, the first of these that there is."""
    return next(name for end in ends for name in reversed(names) if name.endswith(end))


def shown(source, view, field):
    """Colour a source by a point field, with a scale from its values."""
    display = pv.Show(source, view)
    pv.ColorBy(display, ("POINTS", field, "Magnitude"), separate=True)
    display.RescaleTransferFunctionToDataRange(False)
    display.SetScalarBarVisibility(view, True)
    bar = pv.GetScalarBar(display.LookupTable, view)
    unit = next((unit for end, unit in UNITS.items() if field.endswith(end)), "mm")
    bar.Title, bar.ComponentTitle = f"{field} ({unit})", ""
    bar.TitleFontSize, bar.LabelFontSize, bar.WindowLocation = 14, 14, "Upper Right Corner"
    display.LookupTable.ApplyPreset("Viridis (matplotlib)", True)


def look(view, *normal):
    """Look at what is shown against a direction, with z up."""
    view.CameraPosition, view.CameraFocalPoint, view.CameraViewUp = normal, (0, 0, 0), (0, 0, 1)
    view.CameraParallelProjection = 1
    pv.ResetCamera(view)


def show(reader, field=""):
    """Show the last step of a run in two views; return their layout."""
    reader.UpdatePipeline(reader.TimestepValues[-1])
    grid = servermanager.Fetch(reader)
    names = list(reader.PointData.keys())
    regions = grid.GetFieldData().GetAbstractArray("region_names")
    bodies = [regions.GetValue(k) for k in range(regions.GetNumberOfValues())]
    body = bodies.index("stem") + 1 if "stem" in bodies else 1
    low, high = grid.GetBounds()[::2], grid.GetBounds()[1::2]
    layout = pv.CreateLayout("mantle")
    views = [pv.CreateView("RenderView") for _ in range(2)]
    pv.AssignViewToLayout(view=views[0], layout=layout, hint=0)
    layout.SplitHorizontal(0, 0.5)
    pv.AssignViewToLayout(view=views[1], layout=layout, hint=2)
    pv.GetAnimationScene().UpdateAnimationUsingDataTimeSteps()
    pv.GetAnimationScene().GoToLast()

    part = pv.Threshold(Input=reader, Scalars=["CELLS", "region"])
    part.LowerThreshold = part.UpperThreshold = body
    field = field or first(names, FIELDS)
    size = max(reader.PointData["displacement"].GetRange(-1)) if "displacement" in names else 0
    if size > 0:
        part = pv.WarpByVector(Input=part, Vectors=["POINTS", "displacement"])
        part.ScaleFactor = round(
            LARGEST * max(b - a for a, b in zip(low, high, strict=True)) / size
        )
    shown(part, views[0], field)
    look(views[0], 0.6, 0.8, 0.25)

    cut = pv.Slice(Input=reader, SliceType="Plane")
    cut.SliceType.Normal = (0, 1, 0)
    inside = low[1] < -0.1 * (high[1] - low[1]) < 0 < high[1]  # y = 0, else the middle
    cut.SliceType.Origin = (0, 0 if inside else (low[1] + high[1]) / 2, 0)
    shown(cut, views[1], first(names, SECTIONS))
    look(views[1], 0, 1, 0)
    pv.RenderAllViews()
    return layout


if len(sys.argv) > 2:
    source = pv.OpenDataFile(sys.argv[1])
    layout = show(source, *sys.argv[3:4])
    layout.SetSize(1600, 900)
    pv.SaveScreenshot(sys.argv[2], layout, OverrideColorPalette="WhiteBackground")
else:
    show(pv.GetActiveSource())
