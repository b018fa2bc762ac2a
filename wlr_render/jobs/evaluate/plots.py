"""Draw the plots of the sampling study."""

from pathlib import Path

from wlr_render.files import write_figure
from wlr_render.jobs.evaluate.experiment import Plot

_STROKES = ("-", "--", ":", "-.")


def draw(plot: Plot, path: str | Path) -> Path:
    """One picture, errors on a logarithmic axis: a colour for each device, a stroke for each model."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.5, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    devices: list[str] = []
    models: list[str] = []
    for line in plot.lines:
        device, _, model = line.label.partition(", ")
        devices += [device] if device not in devices else []
        models += [model] if model not in models else []
        axes.plot(
            line.x,
            line.y,
            color=f"C{devices.index(device)}",
            linestyle=_STROKES[models.index(model) % len(_STROKES)],
            marker="o",
            markersize=4,
            label=line.label,
        )
    axes.set(title=plot.title, xlabel=plot.x_label, ylabel=plot.y_label, yscale="log")
    axes.grid(True, which="both", alpha=0.3)
    figure.legend(fontsize="x-small", loc="outside right upper", handlelength=4.0)
    return write_figure(path, figure, 120)
