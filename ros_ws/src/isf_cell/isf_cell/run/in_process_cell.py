"""The cell in one process: the same cores as in the nodes, tick by tick, and the record of what they did.

SI units, frame ``sheet``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TypeVar

from isf_analysis.measures.contour_scan import ContourScan, kept_scan
from isf_core.contour import Contour, ContourCorrection, ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.events import Event, torn
from isf_core.files.job import JobFile
from isf_core.simulated_sheet import SheetKind, with_raised_force_limit
from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.controller import ForceController
from isf_force_ctrl.measurements.measurement import AtRest, Measurement
from isf_force_ctrl.measurements.tool_lift import lift_tool
from isf_force_ctrl.supervision.contour_warnings import with_overload
from isf_planner import Plan, plan
from isf_sim.machine.simulated_machine import MachineSample, SimulatedMachine
from isf_springback.corrector import Corrector, apply
from isf_springback.lift_feedback import reading_of
from isf_springback.methods import make_corrector

from isf_cell.run.cell import FormedContour, PartGoal, PlannedPart
from isf_cell.run.cell_wrenches import CellWrenches
from isf_cell.run.part_change import PartChange
from isf_cell.run.tool_lift import NO_ROWS, SETTINGS, lift_rows

POSES = 50.0
"""Hz at which force control hears the poses, as from the machine node."""

M = TypeVar("M", bound=Measurement)


def run_ticks(
    controller: ForceController,
    machine: SimulatedMachine,
    sample: MachineSample,
    wrenches: CellWrenches,
    each: Callable[[MachineSample], None] | None = None,
) -> MachineSample:
    """Tick from ``sample`` until the controller rests, ``each`` sample told first; the last sample.

    The controller hears where the tips are :data:`POSES` times a second, as from a machine in a graph.

    A fault of its load cells ends what the controller is doing with its code. So does one of the machine, at once: it
    takes no more targets, and moves the tools clear by itself.
    """
    every = max(1, round(machine.control_rate / POSES))
    while controller.busy:
        if sample.tick % every == 0:
            for tool, tip in enumerate((sample.tip_1, sample.tip_2), 1):
                controller.add_measured(tool, sample.time, tip.tolist())
        if each is not None:
            each(sample)
        read = wrenches.of(sample)
        if machine.faulted and controller.fault is None:
            controller.fail(*machine.faults[0])
            return machine.release()
        if wrenches.fault is not None and controller.fault is None:
            controller.fail(*wrenches.fault, ticking=True)
        targets = controller.tick(sample.tick, sample.time, *read)
        sample = machine.tick(targets.tip_1, targets.tip_2, targets.holder_height, axis=targets.axis)
    return sample


class InProcessCell:
    """A cell of :mod:`isf_cell.run.cell`, and what happened in it.

    ``part_plan``: the plan to form, ``machine``: the one to form it on; None: made anew. ``control``: parameters of
    force control (ControlConfig) by name, in place of the job's and the defaults. ``change``: settings that change in
    the middle of the part.

    Attributes
    ----------
    part_plan : once planned
    nominal, corrected, corrections, results : one per contour formed
    scans : made between contours
    """

    machine: SimulatedMachine
    sample: MachineSample
    wrenches: CellWrenches

    def __init__(
        self,
        part_plan: Plan | None = None,
        machine: SimulatedMachine | None = None,
        control: Mapping[str, object] | None = None,
        change: PartChange | None = None,
    ) -> None:
        self.part_plan = part_plan
        self._control = dict(control or {})
        self._change = change
        self._given = machine
        self._job_file: JobFile
        self._sheet: SheetKind
        self.nominal: list[Contour] = []
        self.corrected: list[Contour] = []
        self.corrections: list[ContourCorrection] = []
        self.results: list[ContourResult] = []
        self.scans: list[ContourScan] = []
        self._corrector: Corrector
        self._successor: Corrector | None = None
        self._controller: ForceController
        self._sensor = False

    def bring_up(self) -> None:
        """Nothing has to be started."""

    def reset(self, goal: PartGoal) -> None:
        """A new machine with a fresh blank, unless one was given; it bears what the sheet overstates of the force."""
        self._sheet = goal.options.sheet_of(goal.job_file)
        self._job_file = with_raised_force_limit(goal.job_file, self._sheet)
        self.machine = self._given or SimulatedMachine(
            self._job_file, variant=goal.options.variant, seed=goal.options.seed, sheet=goal.options.sheet
        )

    def tare(self) -> None:
        """As in the protocol."""
        self.machine.tare()
        self.wrenches = CellWrenches(self.machine)
        self.sample = self.machine.sample()

    def plan(self, goal: PartGoal) -> PlannedPart:
        """Plan, unless a plan was given."""
        self.part_plan = self.part_plan or plan(goal.job_file)
        made = self.part_plan
        return PlannedPart(made.plan_id, len(made.contours), warnings=made.warnings)

    def arm(self, goal: PartGoal, planned: PlannedPart) -> None:
        """As in the protocol."""
        assert self.part_plan is not None  # planned before
        job_file, sample = self._job_file, self.sample
        self._corrector = make_corrector(goal.method, job_file)
        self._corrector.set_target(self.part_plan.target, self.part_plan.preforms)
        if self._change is not None and self._change.correction is not None:
            method, changed = self._change.correction
            self._successor = make_corrector(method, with_raised_force_limit(changed, self._sheet))
            self._successor.set_target(self.part_plan.target, self.part_plan.preforms)
        config = ControlConfig.from_job(job_file, support_force=goal.options.support_force)
        self._controller = ForceController(replace(config, **self._control))  # type: ignore[arg-type]
        tips = sample.tip_1.tolist(), sample.tip_2.tolist()
        self._controller.arm(planned.plan_id, goal.first_index, planned.count, *tips)
        self._sensor = goal.options.scans_with_sensor(job_file)

    def form_contour(self, index: int) -> FormedContour:
        """As in the protocol."""
        assert self.part_plan is not None  # planned before
        if self._change is not None and index == self._change.first_index:
            self._apply(self._change)
        nominal = self.part_plan.contours[index]
        try:
            correction, corrected = self._start(nominal)
        except IsfError as refusal:
            if self.results:
                self._end(refusal.code, refusal.message)
            raise
        self._run()
        result = self._controller.take_result()
        if result is None:
            raise IsfError(
                ErrorCode.CONTOUR_REJECTED,
                "the force controller ended without a result",
                where=contour_label(index),
            )
        for corrector in self._correctors:
            corrector.add_result(corrected, result)
        result = with_overload(result, self._job_file)
        self.nominal.append(nominal)
        self.corrected.append(corrected)
        self.corrections.append(correction)
        self.results.append(result)
        return FormedContour(nominal, correction, result)

    def _start(self, nominal: Contour) -> tuple[ContourCorrection, Contour]:
        """Begin the next contour, corrected; raises IsfError where correction or force control refuse it."""
        correction = self._corrector.correct(nominal)
        if self._successor is not None:
            same = self._successor.name == self._corrector.name
            self._successor.follow(nominal, correction, predict=same)
        corrected = apply(nominal, correction, support_stays=self._corrector.support_stays)
        self._controller.start(corrected)
        return correction, corrected

    def _end(self, code: ErrorCode, text: str) -> None:
        """The part ends between two contours, which the result of the last one tells."""
        self.results[-1] = replace(self.results[-1], completed=False, code=int(code), message=text)

    def lift(self, formed: FormedContour) -> None:
        """As in the protocol."""
        rows = NO_ROWS
        try:
            lift = lift_tool(self._controller, SETTINGS)
        except IsfError:  # the tools are not on the sheet, as between two features
            pass
        else:
            self._run()
            if lift.code is ErrorCode.OK:
                found = lift.record()
                rows = lift_rows(formed.result, found.springback, found.force, found.lift_z, found.lift_force)
        for corrector in self._correctors:
            corrector.add_lift(reading_of(rows), formed.nominal.index)

    def scan(self, formed: FormedContour, *, aside: bool) -> None:
        """As in the protocol: the upper surface in the clamp."""
        if aside:
            self._controller.move_aside()
            self._run()
        machine = self.machine
        points = (
            machine.measured_cloud(duration=not machine.moving) if self._sensor else machine.measured_shape().points()
        )
        self.sample = machine.sample()  # a scan takes its time
        for corrector in self._correctors:
            corrector.add_scan(points, formed.nominal.index)
        self.scans.append(kept_scan(formed.nominal.index, self.sample.time, points))

    @property
    def events(self) -> tuple[Event, ...]:
        """Of machine and load cells, oldest first."""
        return tuple(sorted((*self.machine.events, *self.wrenches.events), key=lambda event: event.time))

    @property
    def config(self) -> ControlConfig:
        """Of the force controller."""
        return self._controller.config

    def measure(self, make: Callable[[AtRest], M], notify: Callable[[M], None]) -> M:
        """The ended measurement that ``make`` began; ``tell`` is called once per second of its time."""
        controller, rate = self._controller, round(self.machine.control_rate)
        measurement = controller.measure(make)

        def report(sample: MachineSample) -> None:
            if sample.tick % rate == 0:
                notify(measurement)

        self.sample = run_ticks(controller, self.machine, self.sample, self.wrenches, report)
        return measurement

    def check(self) -> None:
        """A fault between two contours is told by the result of the one before."""
        if self._controller.fault is not None:
            code, text = self._controller.fault
            self._end(code, text)
            raise IsfError(code, text)

    def torn(self) -> IsfError | None:
        """As in the protocol."""
        return torn(self.machine.events)

    def explain(self, error: IsfError) -> IsfError:
        """Nothing else can be known."""
        return error

    def stop(self, error: IsfError) -> None:
        """Time stands still: nothing moves."""

    def finish(self) -> None:
        """The shape is read from the machine by whoever wants it."""

    @property
    def _correctors(self) -> tuple[Corrector, ...]:
        """Those that learn what was measured: the one at work, and the one that is to take over."""
        return (self._corrector,) if self._successor is None else (self._corrector, self._successor)

    def _apply(self, change: PartChange) -> None:
        if change.control:
            self._controller.retune(replace(self._controller.config, **change.control))  # type: ignore[arg-type]
        if self._successor is not None:
            self._corrector, self._successor = self._successor, None

    def _run(self) -> None:
        self.sample = run_ticks(self._controller, self.machine, self.sample, self.wrenches)
