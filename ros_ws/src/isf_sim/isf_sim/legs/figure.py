"""Pictures of the legs' responses: set-points and strokes or errors, tip speed and volts, for each controller."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from isf_core.files.hydraulic_legs import Controller
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from isf_sim.legs.tuning import Case, LegResponse

COLOURS: dict[Controller, str] = {"feedforward": "#0072B2", "fuzzy": "#D55E00"}
INK = "#1f2933"


def draw_legs(case: Case, responses: Mapping[Controller, LegResponse], path: Path) -> Path:
    """Write the picture of a case to ``path`` (PNG); returns it.

    Above: errors of the legs (of a step: how far the first one has gone); below: speed of the tip (of a step: volts).
    Lines are the mean over the legs or the tip, bands go from the smallest to the largest leg.
    """
    figure = Figure(figsize=(9.0, 6.0), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for controller, response in responses.items():
        time = np.arange(len(response.wanted)) / response.rate
        colour = COLOURS[controller]
        if case.name == "step":
            _band(upper, time, 1e3 * (response.strokes - response.wanted[-1]), colour, controller)
            _band(lower, time, response.volts, colour, controller)
        else:
            _band(upper, time, 1e6 * (response.strokes - response.wanted), colour, controller)
            steps = np.linalg.norm(np.diff(response.tips, axis=0), axis=1) * response.rate
            lower.plot(time[1:], 1e3 * steps, color=colour, lw=0.9, label=controller)
    if case.name == "step":
        upper.set_ylabel("legs off the new set-point, mm")
        lower.set_ylabel("valves, V")
    else:
        upper.set_yscale("symlog", linthresh=20.0)
        upper.set_ylabel("legs off their set-points, µm")
        lower.set_ylabel("speed of the tip, mm/s")
        lower.axhline(1e3 * case.speed, color=INK, lw=0.8, ls=":")
        lower.set_ylim(0.0, 1.6e3 * case.speed)
    upper.axhline(0.0, color=INK, lw=0.8)
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    upper.legend(frameon=False, ncols=2, title="controller")
    lower.set_xlabel("time, s")
    figure.suptitle(f"{case.text}; line: mean of the legs, band: all six", fontsize=10)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path


def _band(axes: Axes, time: np.ndarray, values: np.ndarray, colour: str, label: str) -> None:
    axes.fill_between(time, values.min(axis=1), values.max(axis=1), color=colour, alpha=0.25, lw=0)
    axes.plot(time, values.mean(axis=1), color=colour, lw=1.0, label=label)
