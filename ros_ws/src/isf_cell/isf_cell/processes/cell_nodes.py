"""The nodes of a cell: which, with what parameters and names. ``isf form`` and the launch file start the same list.

The launch file is read by the Python of ROS, which need not have the libraries of this workspace: nothing but the
standard library is imported here.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Any

OWN_CLOCK = ("/clock", "clock")
"""A machine in lockstep owns the time of its own cell: two of them must not publish on one topic."""

OWN_FRAMES = (("/tf", "tf"), ("/tf_static", "tf_static"))
"""Every cell has a frame ``sheet``: where two share /tf, one of them needs a prefix, or each topics of its own."""


OPERATOR = "operator"
"""Whose enclave commands have, such as ``isf form``."""


def enclave(name: str) -> str:
    """Security enclave of the node ``name``, as in ``config/security/policy.xml``."""
    return f"/isf/{name}"


def enclave_arguments(name: str) -> list[str]:
    """ROS arguments that give the node its enclave; none while security is off, or one is given for all processes."""
    on = os.environ.get("ROS_SECURITY_ENABLE") == "true" and not os.environ.get("ROS_SECURITY_ENCLAVE_OVERRIDE")
    return ["--enclave", enclave(name)] if on else []


def operator_arguments() -> list[str] | None:
    """For ``rclpy.init`` of a command: None, or its enclave."""
    enclaved = enclave_arguments(OPERATOR)
    return ["--ros-args", *enclaved] if enclaved else None


@dataclass(frozen=True)
class CellNode:
    """One node of a cell.

    Attributes
    ----------
    name : of the node ; package, executable : what is started
    parameters : by name ; remap : pairs of names
    managed : the executive takes it through its transitions
    outlives : ended after the others, since what they say last is for it
    keeps_nothing : started anew it does the same again; no tool depends on it from one tick to the next
    """

    name: str
    package: str
    executable: str
    parameters: dict[str, Any] = field(default_factory=dict)
    remap: tuple[tuple[str, str], ...] = ()
    managed: bool = False
    outlives: bool = False
    keeps_nothing: bool = False


@dataclass(frozen=True)
class CellChoice:
    """What a cell is made of.

    Attributes
    ----------
    lockstep : machine and force control step together; else by the clock
    machine : the simulated one is started; else the cell's own driver is there
    load_cells : tools whose wrench a node load_cell makes from raw readings
    tilts : tool 1 is tilted, and its cells with it
    cell_files : tool to the file of its cell ; rig : rig file, for cells without a file of their own, and for viewers
    bag : folder to record to; "": none ; text_log : file of 12 columns that is written beside it; "": none
    checkpoint : folder that a part is kept in; "": none
    runs : folder below which each part may be kept in one of its own, where there is no checkpoint; "": none
    viewers : frames, joint states and sheet for RViz and others are published
    job : job file that viewers describe, and whose rig and tools an operator moves before a part; "": that of the part
    frame_prefix : before the name of every frame ; own_frames : on topics tf and tf_static of the cell
    publish_tf : false, where robot_state_publisher makes the frames
    ros2_control : the machine's axes are driven by controller_manager
    every_pose : the machine tells its poses in each tick, not 50 times a second
    """

    lockstep: bool = True
    machine: bool = True
    load_cells: tuple[int, ...] = ()
    tilts: bool = False
    cell_files: dict[int, str] = field(default_factory=dict)
    rig: str = ""
    bag: str = ""
    text_log: str = ""
    checkpoint: str = ""
    runs: str = ""
    viewers: bool = False
    job: str = ""
    frame_prefix: str = ""
    own_frames: bool = False
    publish_tf: bool = True
    ros2_control: bool = False
    every_pose: bool = False


def cell_nodes(choice: CellChoice) -> list[CellNode]:
    """All nodes of the cell, in the order in which they are started."""
    kept = choice.checkpoint or choice.runs
    states = {"state_folder": kept} if kept else {}
    timing: dict[str, Any] = {"lockstep": choice.lockstep}
    frames = OWN_FRAMES if choice.own_frames else ()
    nodes = []
    if choice.bag:
        wanted: dict[str, Any] = {"output": choice.bag, "autostart": True}
        if choice.text_log:
            wanted["text_log"] = choice.text_log
        nodes.append(CellNode("recorder", "isf_analysis", "recorder", wanted, frames, outlives=True))
    if choice.machine:
        raw: dict[str, Any] = {"raw_cells": bool(choice.load_cells)}
        if choice.ros2_control:
            raw["follow"] = "joints"
        if choice.every_pose:
            raw["pose_decimation"] = 1
        nodes.append(CellNode("machine", "isf_sim", "machine", {**timing, **raw, **states}, managed=True))
    nodes += [_load_cell(choice, tool) for tool in choice.load_cells]
    nodes.append(CellNode("planner", "isf_planner", "planner", managed=True, keeps_nothing=True))
    nodes.append(CellNode("springback", "isf_springback", "springback", states, managed=True, keeps_nothing=True))
    prefix = {"frame_prefix": choice.frame_prefix} if choice.frame_prefix else {}
    output = {"output": "joint_trajectory", "described_joints": True} if choice.ros2_control else {}
    control = {**timing, **states, **prefix, **output}
    nodes.append(CellNode("force_ctrl", "isf_force_ctrl", "force_ctrl", control, frames, managed=True))
    executive = {**timing, "load_cells": " ".join(str(tool) for tool in choice.load_cells)}
    if choice.job:
        executive["job"] = choice.job
    if choice.checkpoint:
        executive["checkpoint"] = choice.checkpoint
    elif choice.runs:
        executive["state_folder"] = choice.runs
    nodes.append(CellNode("executive", "isf_cell", "executive", executive))
    if choice.viewers:
        nodes.append(_viewer(choice, frames))
    return nodes


def _load_cell(choice: CellChoice, tool: int) -> CellNode:
    known: dict[str, Any] = {"tool": tool}
    if tool in choice.cell_files:
        known["file"] = choice.cell_files[tool]
    if choice.rig:
        known["rig"] = choice.rig
    names = ["raw", "raw_cells", "wrench"]
    if choice.tilts and tool == 1:
        known["with_pose"] = True
        names.append("pose")
    remap = tuple((name, f"tool_{tool}/{name}") for name in names)
    return CellNode(f"load_cell_{tool}", "isf_load_cell", "load_cell", known, remap, managed=True)


def _viewer(choice: CellChoice, frames: tuple[tuple[str, str], ...]) -> CellNode:
    name = "cell_state_publisher"
    parameters: dict[str, Any] = {
        "autostart": True,
        "lockstep": choice.lockstep,
        "job": choice.job,
        "rig": choice.rig,
        "frame_prefix": choice.frame_prefix,
        "publish_tf": choice.publish_tf,
    }
    if choice.ros2_control:
        parameters["ros2_control"] = True
    return CellNode(name, "isf_description", name, parameters, frames, keeps_nothing=True)
