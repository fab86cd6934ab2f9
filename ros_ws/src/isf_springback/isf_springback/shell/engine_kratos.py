"""The elastic sheet by KratosMultiphysics: a heavier engine behind the same interface, to check the compact one.

Three-node thin shell facets (ShellThinElementCorotational3D3N) on the mesh of the compact engine, with its thickness
and edge condition; full Newton in small load steps. Optional: the packages are imported where they are needed. Lengths
in m, forces in N, frame ``sheet``.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.standard_output import output_to_stderr
from isf_core.types import Array

from isf_springback.shell.sheet_model import EdgeCondition, SheetMesh, edge_springs, held_freedoms

PACKAGES = "KratosMultiphysics KratosStructuralMechanicsApplication"
ELEMENT = "ShellThinElementCorotational3D3N"
PART = "sheet"
TOLERANCE = 1e-6
"""Of the last correction and of the residual, relative."""

ITERATIONS = 25
SUBDIVISIONS = (2, 8, 32)
"""Load steps per level, tried in this order until every step converges."""


def kratos_displacement(
    mesh: SheetMesh,
    thickness: Array,
    young: float,
    poisson: float,
    edge: EdgeCondition,
    direction: Array,
    loads: Array,
) -> Array:
    """(M, L, 3) m, displacement of each of the ``mesh.loaded`` nodes, loaded alone along ``direction`` (3,).

    Parameters
    ----------
    thickness : (T,) m of every facet ; young, poisson : Pa, -
    loads : (L,) N, rising

    Raises
    ------
    IsfError : FILE_NOT_FOUND, the packages are not installed; SHELL_NOT_SOLVED, no equilibrium at a level
    """
    kratos, structural = _packages()
    rows = []
    for node in mesh.loaded:
        for steps in SUBDIVISIONS:
            model = _sheet_model(kratos, structural, mesh, thickness, young, poisson, edge)
            row = _follow(kratos, model.GetModelPart(PART), int(node), direction, loads, steps)
            if row is not None:
                break
        else:
            raise IsfError(
                ErrorCode.SHELL_NOT_SOLVED,
                f"Kratos finds no equilibrium of the sheet up to {loads[-1]:.0f} N",
                where="springback.elastic.engine kratos",
                advice="lower springback.elastic.largest_load, or use engine compact",
            )
        rows.append(row)
    return np.stack(rows)


def _packages() -> tuple[Any, Any]:
    """The core with its solvers, and the application with the shells, without their banners on standard output."""
    try:
        with output_to_stderr():
            kratos = import_module("KratosMultiphysics")
            kratos.Logger.GetDefaultOutput().SetSeverity(kratos.Logger.Severity.WARNING)
            import_module("KratosMultiphysics.LinearSolversApplication")
            structural = import_module("KratosMultiphysics.StructuralMechanicsApplication")
    except ImportError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_FOUND,
            f"Kratos cannot be loaded: {error}",
            where="springback.elastic.engine",
            advice=f"install it with: pip install {PACKAGES}; or use engine compact",
        ) from error
    return kratos, structural


def _sheet_model(
    kratos: Any,
    structural: Any,
    mesh: SheetMesh,
    thickness: Array,
    young: float,
    poisson: float,
    edge: EdgeCondition,
) -> Any:
    """Kratos model of the unloaded sheet: node k + 1 is node k of the mesh, properties by thickness in micrometres."""
    model = kratos.Model()
    part = model.CreateModelPart(PART)
    part.SetBufferSize(2)
    part.ProcessInfo[kratos.DOMAIN_SIZE] = 3
    variables = (kratos.DISPLACEMENT, kratos.ROTATION, kratos.REACTION, kratos.REACTION_MOMENT)
    for variable in (*variables, structural.POINT_LOAD, kratos.VOLUME_ACCELERATION):
        part.AddNodalSolutionStepVariable(variable)
    for number, (x, y, z) in enumerate(mesh.points.tolist(), start=1):
        part.CreateNewNode(number, x, y, z)
    law = structural.LinearElasticPlaneStress2DLaw()
    micrometres = np.maximum(np.round(1e6 * thickness), 1.0).astype(int)
    for value in np.unique(micrometres).tolist():
        properties = part.CreateNewProperties(value)
        properties.SetValue(kratos.YOUNG_MODULUS, young)
        properties.SetValue(kratos.POISSON_RATIO, poisson)
        properties.SetValue(kratos.THICKNESS, 1e-6 * value)
        properties.SetValue(kratos.DENSITY, 0.0)
        properties.SetValue(kratos.CONSTITUTIVE_LAW, law)
    for number, (corners, value) in enumerate(zip(mesh.triangles + 1, micrometres, strict=True), start=1):
        part.CreateNewElement(ELEMENT, number, corners.tolist(), part.GetProperties()[int(value)])
    for name, reaction in (("DISPLACEMENT", "REACTION"), ("ROTATION", "REACTION_MOMENT")):
        for axis in "XYZ":
            kratos.VariableUtils().AddDof(_variable(kratos, name, axis), _variable(kratos, reaction, axis), part)
    for freedom in held_freedoms(mesh, edge).tolist():
        node, number = divmod(freedom, 6)
        name = "DISPLACEMENT" if number < 3 else "ROTATION"
        part.GetNode(node + 1).Fix(_variable(kratos, name, "XYZ"[number % 3]))
    _add_springs(kratos, structural, part, mesh, edge)
    return model  # the part lives as long as its model


def _variable(kratos: Any, name: str, axis: str) -> Any:
    return getattr(kratos, f"{name}_{axis}")


def _add_springs(kratos: Any, structural: Any, part: Any, mesh: SheetMesh, edge: EdgeCondition) -> None:
    springs = edge_springs(mesh, edge)
    if springs is None:
        return
    properties = part.CreateNewProperties(0)
    first = len(mesh.triangles) + 1
    for number, node in enumerate(mesh.edge.tolist(), start=first):
        element = part.CreateNewElement("NodalConcentratedElement3D1N", number, [node + 1], properties)
        element.SetValue(structural.NODAL_DISPLACEMENT_STIFFNESS, springs[6 * node : 6 * node + 3].tolist())


def _follow(kratos: Any, part: Any, node: int, direction: Array, loads: Array, steps: int) -> Array | None:
    """(L, 3) m, displacement of ``node`` at every load, or None when a load step does not converge."""
    properties = part.CreateNewProperties(2_000_000)
    part.CreateNewCondition("PointLoadCondition3D1N", 1, [node + 1], properties)
    strategy = _strategy(kratos, part)
    loaded = part.GetNode(node + 1)
    result, time, before = np.empty((len(loads), 3)), 0.0, 0.0
    point_load = kratos.KratosGlobals.GetVariable("POINT_LOAD")
    for level, load in enumerate(loads.tolist()):
        for force in np.linspace(before, load, steps + 1)[1:].tolist():
            time += 1.0
            part.CloneTimeStep(time)
            loaded.SetSolutionStepValue(point_load, (force * direction).tolist())
            strategy.Initialize()
            strategy.InitializeSolutionStep()
            strategy.Predict()
            if not strategy.SolveSolutionStep():
                return None
            strategy.FinalizeSolutionStep()
        result[level] = list(loaded.GetSolutionStepValue(kratos.DISPLACEMENT))
        if not np.isfinite(result[level]).all():
            return None
        before = load
    return result


def _strategy(kratos: Any, part: Any) -> Any:
    """Newton with a direct solver; correction and residual have to be small."""
    factory = import_module("KratosMultiphysics.python_linear_solver_factory")
    solver = factory.ConstructSolver(kratos.Parameters('{"solver_type": "LinearSolversApplication.sparse_lu"}'))
    scheme = kratos.ResidualBasedIncrementalUpdateStaticScheme()
    criterion = kratos.AndCriteria(
        kratos.ResidualCriteria(TOLERANCE, 1e-9), kratos.DisplacementCriteria(TOLERANCE, 1e-10)
    )
    criterion.SetEchoLevel(0)
    builder = kratos.ResidualBasedBlockBuilderAndSolver(solver)
    strategy = kratos.ResidualBasedNewtonRaphsonStrategy(
        part, scheme, criterion, builder, ITERATIONS, False, False, True
    )
    strategy.SetEchoLevel(0)
    return strategy
