"""Control ticks of force controller and simulated machine in one process."""

from __future__ import annotations

from isf_force_ctrl.measuring_controller import MeasuringController
from isf_sim.machine.simulated_machine import MachineSample, SimulatedMachine


def run_ticks(controller: MeasuringController, machine: SimulatedMachine, sample: MachineSample) -> MachineSample:
    """Tick from ``sample`` until the controller rests; the last sample.

    A fault of the machine, which holds from then on, ends what the controller is doing with the machine's code.
    """
    while controller.busy:
        if machine.faults and controller.fault is None:
            controller.fail(*machine.faults[0], ticking=True)
        targets = controller.tick(sample.tick, sample.time, sample.wrench_1.tolist(), sample.wrench_2.tolist())
        sample = machine.tick(targets.tip_1, targets.tip_2, targets.holder_height)
    return sample
