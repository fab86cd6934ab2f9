"""The machine of a cell, simulated or the cell's own driver: what it offers beyond its streams, asked for and used.

What a driver may leave out: docs/own_cell/drivers.md. A machine in lockstep is the simulated one, which offers all of
it. For a worker thread.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_msgs.srv import Reset, Scan, StateFile, Stop, Tare
from isf_springback.methods import needs_scans
from lifecycle_msgs.srv import GetState
from rcl_interfaces.srv import GetParameters

from isf_cell.run.cell import PartGoal
from isf_cell.run.graph_client import GraphClient, Watch

MACHINE = "machine"

DISCOVERY = 3.0
"""s after which a service of a driver that is running has been discovered, or does not exist. Fast DDS exchanges what a
process offers as soon as it knows the process, which it announces every 3 s."""

HARMLESS = (GetParameters, f"{MACHINE}/get_parameters")
"""What every node offers, as a rule; its client is to be made after those of the commands."""


@dataclass(frozen=True)
class MachineOffer:
    """What a machine offers beyond its streams.

    Attributes
    ----------
    lifecycle, reset, tare, stop, scan : services
    state : machine/state is published
    scanner : scans are published, by the machine or by a scanner of its own
    simulated : it is the simulated machine
    """

    lifecycle: bool = True
    reset: bool = True
    tare: bool = True
    stop: bool = True
    scan: bool = True
    state: bool = True
    scanner: bool = True
    simulated: bool = True

    def consequences(self, *, wrenches_tared: bool) -> Iterator[str]:
        """What follows from each thing that is not offered, for people."""
        if not self.lifecycle:
            yield "the driver has no lifecycle services: it is taken as always active"
        if not self.reset:
            yield "no machine/reset: the blank in the clamp is used, faults are cleared at the machine"
        if not self.tare and wrenches_tared:
            yield "no machine/tare: the wrenches are taken as tared, as wrenches_tared of force_ctrl says"
        if not self.state:
            yield "no machine/state: faults of the machine are not known, a driver that is gone is noticed by its poses"
        if not self.stop:
            yield "no machine/stop: when a part ends early, force_ctrl stops and lifts the tools"
        if not self.scan and self.scanner:
            yield "no machine/scan: the scans are those that come on scan by themselves"
        elif not self.scan:
            yield "no machine/scan: nothing is measured, the report is without the formed shape"


class MachineClient:
    """Calls to the machine; what it does not offer is left out.

    ``lockstep``: every service is needed, and waited for. ``report`` is told what is left out.
    """

    def __init__(self, client: GraphClient, *, lockstep: bool, report: Callable[[str], None]) -> None:
        self._client, self._lockstep, self._report = client, lockstep, report
        self._tared = False
        self.taken_up = False
        """A saved simulated machine goes on, with the tare that it had."""
        self._found = 0.0
        self.offer = MachineOffer()
        """As far as it was looked for: before, all of it."""

    def find(self, watch: Watch, heard: Callable[[], bool]) -> bool:
        """Wait until the machine is there: True when it is to be brought up, False for one that is always active.

        ``heard``: true when a message of the machine has come. That somebody publishes is not enough: the middleware
        goes on to name a process that was killed for up to 20 s. Raises IsfError NODE_MISSING.
        """
        if self._lockstep:
            return True
        client = self._client
        client.wait_until(
            lambda: self._is_managed() or heard(),
            watch,
            "there is no machine: neither the service machine/get_state nor a message on tool_1/pose or machine/state",
            ErrorCode.NODE_MISSING,
            advice="start the driver; where its names differ, the executive needs the same remappings as force_ctrl",
        )
        self._found = time.monotonic()
        return client.within(DISCOVERY, self._is_managed, watch)

    def look(self, watch: Watch, *, lifecycle: bool) -> None:
        """Find out what the machine, brought up, offers, and report what follows from it.

        Raises IsfError NO_TARE when nobody can say that its wrenches are tared.
        """
        if self._lockstep:
            return
        client = self._client
        left = self._found + DISCOVERY - time.monotonic()
        client.within(max(left, 0.0), lambda: all(self._services().values()) and self._tells_state(), watch)
        found = self._services()
        self.offer = MachineOffer(
            **found,
            lifecycle=lifecycle,
            state=self._tells_state(),
            scanner=found["scan"] or bool(client.publishers("scan")),
            simulated=client.offers(StateFile, f"{MACHINE}/save"),
        )
        self._tared = bool(client.get_parameter("force_ctrl", "wrenches_tared", watch))
        if not (self._tared or (self.offer.tare and self.offer.state)):
            lacking = "the service machine/tare" if self.offer.state else "machine/state, which says that it was done"
            raise IsfError(
                ErrorCode.NO_TARE,
                f"the load cells cannot be tared: the driver does not offer {lacking}",
                where=MACHINE,
                advice="offer both, or start force_ctrl with wrenches_tared:=true where the wrenches come tared",
            )
        for line in self.offer.consequences(wrenches_tared=self._tared):
            self._report(line)

    def check(self, method: str, job_file: JobFile) -> None:
        """Raise IsfError SCAN_MISSING when ``method`` corrects from scans and nobody makes any."""
        if not self.offer.scanner and needs_scans(method):
            raise IsfError(
                ErrorCode.SCAN_MISSING,
                f"the method {method} corrects from scans, and the driver offers no machine/scan",
                where="springback.method",
                advice="choose a method without scans (none, analytic, elastic), or have a scanner publish on scan",
            )
        if not self.offer.scanner and job_file.job.springback.scan_every:
            self._report("the scans between contours that the job asks for are left out")

    def reset(self, goal: PartGoal, watch: Watch, *, timeout: float) -> None:
        """A fresh blank for the simulated machine; faults are cleared where that is offered."""
        if not self.offer.reset:
            return
        request = Reset.Request(
            new_blank=goal.first_index == 0,
            job_text=goal.job_file.text,
            base_folder=str(goal.job_file.base),
            world=goal.options.variant,
            seed=goal.options.seed,
            sheet=goal.options.sheet or "",
        )
        self._client.checked_call(Reset, f"{MACHINE}/reset", request, watch, timeout=timeout)

    def save(self, path: str, watch: Watch, *, timeout: float) -> None:
        """Have the simulated machine write its state to ``path`` below its folder."""
        self._client.checked_call(StateFile, f"{MACHINE}/save", StateFile.Request(path=path), watch, timeout=timeout)

    def take_up(self, path: str, watch: Watch, *, timeout: float) -> None:
        """Go on with the simulated machine saved at ``path``, its tools where they were."""
        self._client.checked_call(StateFile, f"{MACHINE}/load", StateFile.Request(path=path), watch, timeout=timeout)
        self.taken_up = True

    def tare(self, watch: Watch) -> None:
        """Set the load cells to zero, once: a second tare would still be going on when the tools move.

        The middleware may drop an answer right after it has found a driver that nothing was asked before, so something
        harmless is asked first, as often as it takes. The driver knows who asks for a tare when it has answered that:
        clients become known in the order in which they were made (:data:`HARMLESS`).
        """
        if self.offer.tare:
            if self._client.offers(*HARMLESS):
                self._client.ask(*HARMLESS, GetParameters.Request(), watch)
            self._client.checked_call(Tare, f"{MACHINE}/tare", Tare.Request(), watch)

    @property
    def tells_tare(self) -> bool:
        """True when machine/state has to say that the load cells are tared."""
        return self.offer.state and not self._tared

    def scan(self, watch: Watch, *, sensor: bool) -> None:
        """Have the present shape measured."""
        if self.offer.scan:
            request = Scan.Request(clamped=True, sensor=sensor)
            self._client.checked_call(Scan, f"{MACHINE}/scan", request, watch)

    def stop(self, reason: str, watch: Watch) -> None:
        """Protective stop."""
        self._client.call(Stop, f"{MACHINE}/stop", Stop.Request(reason=reason), watch)

    # -- inside ----------------------------------------------------------------------------------

    def _is_managed(self) -> bool:
        return self._client.offers(GetState, f"{MACHINE}/get_state")

    def _services(self) -> dict[str, bool]:
        kinds = {"reset": Reset, "tare": Tare, "stop": Stop, "scan": Scan}
        return {name: self._client.offers(kind, f"{MACHINE}/{name}") for name, kind in kinds.items()}

    def _tells_state(self) -> bool:
        return self._client.publishers("machine/state") > 0
