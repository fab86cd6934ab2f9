"""The small example cone in few and quick contours, for tests that need a whole part but no fine one."""

from __future__ import annotations

from pathlib import Path

from isf_core.files.job import JobFile

FOLDER = Path(__file__).resolve().parents[1] / "examples" / "jobs"
DEPTH = "incremental_depth: 0.5 mm"
LONGER, CONTOURS_OF_LONGER = "1 mm", 5
"""``step`` and number of contours of a part that is long enough for something to happen to it before its last one."""

PACE = {
    "point_spacing: 0.5 mm": "point_spacing: 1 mm",
    # the fewest ticks: at a higher feed the force error grows, and the controller goes slower than at this one
    "feed: 30 mm/s": "feed: 20 mm/s",
    "rate: 500 Hz": "rate: 100 Hz",
}
CONTOURS = 3
"""Of a part with the step that is used if none is given."""


def quick_cone(springback: str = "method: analytic", *, step: str = "1.7 mm") -> JobFile:
    """The job with ``springback`` as the fields of that section and contours ``step`` apart."""
    text = (FOLDER / "mini_cone.yaml").read_text(encoding="utf-8")
    for old, new in {DEPTH: f"incremental_depth: {step}", **PACE, "method: elastic": springback}.items():
        assert old in text
        text = text.replace(old, new)
    return JobFile(text, FOLDER)


def quick_cone_file(folder: Path, *, step: str = "1.7 mm") -> Path:
    """The job as a file in ``folder``."""
    path = folder / "quick_cone.yaml"
    parts = str(FOLDER.parent / "parts")
    path.write_text(quick_cone(step=step).text.replace("../parts", parts), encoding="utf-8")
    return path
