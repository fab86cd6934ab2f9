"""A URDF file read without the code that writes it: where a frame stands for positions of the joints."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Matrix = NDArray[np.float64]


class Urdf:
    """Links and joints of ``text``; a tree with one root, or the file is not valid."""

    def __init__(self, text: str) -> None:
        self.robot = ElementTree.fromstring(text)
        self.links = {link.attrib["name"]: link for link in self.robot.findall("link")}
        self.joints = {joint.attrib["name"]: joint for joint in self.robot.findall("joint")}
        self._above = {joint.find("child").attrib["link"]: joint for joint in self.joints.values()}  # type: ignore[union-attr]
        assert len(self.links) == len(self.robot.findall("link"))
        assert len(self._above) == len(self.robot.findall("joint")) == len(self.links) - 1
        (self.root,) = set(self.links) - set(self._above)
        for joint in self.joints.values():
            assert {joint.find("parent").attrib["link"], joint.find("child").attrib["link"]} <= set(self.links)  # type: ignore[union-attr]

    def transform(self, base: str, frame: str, positions: Mapping[str, float]) -> Matrix:
        """(4, 4), from axes of ``frame`` to axes of ``base``."""
        return np.linalg.inv(self._in_root(base, positions)) @ self._in_root(frame, positions)

    def limits(self, joint: str) -> tuple[float, float]:
        """lower and upper"""
        limit = self.joints[joint].find("limit")
        assert limit is not None
        return float(limit.attrib["lower"]), float(limit.attrib["upper"])

    def _in_root(self, frame: str, positions: Mapping[str, float]) -> Matrix:
        result = np.eye(4)
        while frame != self.root:
            joint = self._above[frame]
            result = self._step(joint, positions.get(joint.attrib["name"], 0.0)) @ result
            frame = joint.find("parent").attrib["link"]  # type: ignore[union-attr]
        return result

    @staticmethod
    def _step(joint: ElementTree.Element, position: float) -> Matrix:
        origin, axis = joint.find("origin"), joint.find("axis")
        assert origin is not None
        step, move = np.eye(4), np.eye(4)
        step[:3, 3] = numbers(origin.attrib["xyz"])
        step[:3, :3] = Rotation.from_euler("xyz", numbers(origin.attrib["rpy"])).as_matrix()
        if joint.attrib["type"] != "fixed":
            assert axis is not None
            along = position * numbers(axis.attrib["xyz"])
            if joint.attrib["type"] == "prismatic":
                move[:3, 3] = along
            else:
                move[:3, :3] = Rotation.from_rotvec(along).as_matrix()
        return step @ move


def numbers(text: str) -> Matrix:
    """Three numbers of an attribute."""
    return np.array([float(part) for part in text.split()])
