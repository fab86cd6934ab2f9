"""Kratos behind the interface of the shell: the same plates and parts, skipped only where it is not installed."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_springback.database.elastic_samples import DepthTask, solve_depth
from isf_springback.shell import engine_kratos
from isf_springback.shell.engine_kratos import kratos_displacement
from isf_springback.shell.formed_sheet import FacetSize, formed_sheet
from isf_springback.shell.sheet_model import EdgeCondition
from shell_sheets import DOWN, POISSON, YOUNG, cone_contours, disc, flat_sheet

COARSE = FacetSize(4e-3, 8e-3, 16e-3)
# The engine is optional and has wheels for few systems; that it is refused with a code without them is tested always.
with_kratos = pytest.mark.skipif(
    importlib.util.find_spec("KratosMultiphysics") is None,
    reason="KratosMultiphysics is not installed: 145 MB for checks alone (docs/methods/springback_elastic.md)",
)


def task(engine: str, edge: EdgeCondition = EdgeCondition()) -> DepthTask:  # noqa: B008 - frozen
    contours = cone_contours(40e-3, 45.0, 12e-3, step=2e-3)
    return DepthTask(
        index=contours[-1].index,
        sheet=formed_sheet(contours, (0.25, 0.25)),
        points=contours[-1].contact[:1, :2],
        direction=DOWN,
        loads=np.array([200.0, 600.0]),
        young=YOUNG,
        poisson=POISSON,
        thickness=1e-3,
        edge=edge,
        size=COARSE,
        engine=engine,
    )


def test_a_missing_engine_is_reported_with_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ImportError(f"No module named '{name}'")

    monkeypatch.setattr(engine_kratos, "import_module", missing)
    with pytest.raises(IsfError) as error:
        solve_depth(task("kratos"))
    assert error.value.code == ErrorCode.FILE_NOT_FOUND
    assert "pip install KratosMultiphysics" in str(error.value)


def test_results_of_the_engines_have_names_of_their_own() -> None:
    assert task("compact").digest() == replace(task("kratos"), engine="compact").digest()
    assert task("compact").digest() != task("kratos").digest()


@with_kratos
@pytest.mark.slow
@pytest.mark.parametrize(
    ("slope", "spring", "expected"),
    [("clamped", np.inf, 3.930), ("clamped", 0.0, 5.204), ("supported", np.inf, 4.149), ("supported", 0.0, 6.567)],
)
def test_disc_against_foppl_von_karman(slope: str, spring: float, expected: float) -> None:
    """Disc of 141 mm, 1 mm thick, 400 N in the middle: the four edges of an independent solution, within 1 %."""
    mesh = flat_sheet(disc(0.141))
    edge = EdgeCondition("clamped" if slope == "clamped" else "supported", spring)
    thickness = np.full(len(mesh.triangles), 1e-3)
    moved = kratos_displacement(mesh, thickness, YOUNG, POISSON, edge, DOWN, np.array([200.0, 400.0]))
    assert -1e3 * moved[0, -1, 2] == pytest.approx(expected, rel=0.01)


@with_kratos
@pytest.mark.parametrize("spring", [0.0, 45e6])
def test_both_engines_agree_on_a_cone(spring: float) -> None:
    """Same mesh, thickness and edge: both are corotational flat facets, so 2 % covers their elements."""
    edge = EdgeCondition("clamped", spring)
    assert solve_depth(task("kratos", edge)) == pytest.approx(solve_depth(task("compact", edge)), rel=0.02)


@with_kratos
def test_results_on_standard_output_stay_readable(capfd: pytest.CaptureFixture[str]) -> None:
    solve_depth(replace(task("kratos"), loads=np.array([50.0])))
    assert capfd.readouterr().out == ""


def test_the_engine_is_loaded_only_where_it_is_used() -> None:
    text = Path(engine_kratos.__file__).read_text(encoding="utf-8")
    assert "\nimport Kratos" not in text
    assert "\nfrom Kratos" not in text
