"""The small example cone in few and quick contours, for tests that need a whole part but no fine one."""

from __future__ import annotations

from pathlib import Path

from isf_core.files.job import JobFile

FOLDER = Path(__file__).resolve().parents[1] / "examples" / "jobs"
STEP = {"incremental_depth: 0.5 mm": "incremental_depth: 1 mm"}
PACE = {
    "point_spacing: 0.5 mm": "point_spacing: 1 mm",
    # the fewest ticks: at a higher feed the force error grows, and the controller goes slower than at this one
    "feed: 30 mm/s": "feed: 20 mm/s",
    "rate: 500 Hz": "rate: 100 Hz",
}
CONTOURS = 5


def quick_cone(springback: str = "method: analytic", *, coarse: bool = True) -> JobFile:
    """The job with ``springback`` as the fields of that section; all ten contours of it unless ``coarse``."""
    text = (FOLDER / "mini_cone.yaml").read_text(encoding="utf-8")
    for old, new in {**(STEP if coarse else {}), **PACE, "method: analytic": springback}.items():
        assert old in text
        text = text.replace(old, new)
    return JobFile(text, FOLDER)


def quick_cone_file(folder: Path) -> Path:
    """The coarse job as a file in ``folder``."""
    path = folder / "quick_cone.yaml"
    parts = str(FOLDER.parent / "parts")
    path.write_text(quick_cone().text.replace("../parts", parts), encoding="utf-8")
    return path
