"""Contact-force control and compliance compensation of the two tools of a forming cell."""

from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_state import ControlState, Mode, Targets
from isf_force_ctrl.controller import ForceController

__all__ = ["ControlConfig", "ControlState", "ForceController", "Mode", "Targets"]
