"""The layouts against what their programs read: panels, displays, keys and values, as literals from the sources."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import yaml
from isf_core.files.rig import load_rig
from isf_description.cell import describe

LAYOUTS = Path(__file__).resolve().parents[1] / "layouts"

PANEL_KEYS = {
    "3D": "cameraState followMode followTf scene transforms topics layers publish imageMode",
    "Plot": "foxglovePanelTitle paths minXValue maxXValue minYValue maxYValue showLegend legendDisplay "
    "showPlotValuesInLegend showXAxisLabels showYAxisLabels isSynced xAxisVal xAxisPath followingViewWidth "
    "sidebarDimension",
    "StateTransitions": "foxglovePanelTitle paths isSynced",
    "RawMessages": "diffEnabled diffMethod diffTopicPath expansion showFullMessageForDiff topicPath",
    "RosOut": "searchTerms minLogLevel topicToRender",
    "DiagnosticSummary": "minLevel pinnedIds hardwareIdFilter topicToRender sortByLevel",
}
"""What the panels of Foxglove Studio 1.48 read of their configuration, by panel type: types.d.ts of each panel."""

CAMERA = "distance perspective phi target targetOffset targetOrientation thetaOffset fovy near far"
TRANSFORMS = "editable showLabel labelSize axisScale lineWidth lineColor enablePreloading"
SCENE = (
    "enableStats backgroundColor labelScaleFactor ignoreColladaUpAxis meshUpAxis transforms syncCamera topicsVisible"
)
GRID = "visible frameLocked instanceId layerId label order frameId size divisions lineWidth color position rotation"
LINE = "color value label enabled timestampMethod"

TOPIC_KEYS = {
    "std_msgs/msg/String": "visible",
    "visualization_msgs/msg/Marker": "visible color selectedIdVariable namespaces",
    "visualization_msgs/msg/MarkerArray": "visible color selectedIdVariable namespaces",
    "sensor_msgs/msg/PointCloud2": "visible frameLocked pointSize pointShape decayTime colorMode flatColor colorField "
    "gradient colorMap explicitAlpha minValue maxValue",
    "nav_msgs/msg/Path": "visible type axisScale arrowScale lineWidth gradient",
    "geometry_msgs/msg/PoseStamped": "visible type axisScale arrowScale color showCovariance covarianceColor",
}
"""Settings of a topic in the panel 3D, by the type of its messages."""

SHOWN = {
    "/robot_description": "std_msgs/msg/String",
    "/part/sheet": "visualization_msgs/msg/Marker",
    "/part/markers": "visualization_msgs/msg/MarkerArray",
    "/scan": "sensor_msgs/msg/PointCloud2",
    "/machine/formed_sheet": "sensor_msgs/msg/PointCloud2",
    "/part/target": "sensor_msgs/msg/PointCloud2",
    "/tool_1/path": "nav_msgs/msg/Path",
    "/tool_2/path": "nav_msgs/msg/Path",
    "/contour/path": "nav_msgs/msg/Path",
    "/tool_1/pose": "geometry_msgs/msg/PoseStamped",
    "/tool_2/pose": "geometry_msgs/msg/PoseStamped",
}


def unknown(given: dict[str, Any], known: str) -> set[str]:
    """Keys that nothing reads."""
    return set(given) - set(known.split())


def foxglove() -> dict[str, Any]:
    layout: dict[str, Any] = json.loads((LAYOUTS / "cell_foxglove.json").read_text(encoding="utf-8"))
    return layout


def test_foxglove_knows_every_panel_and_every_key() -> None:
    layout = foxglove()
    assert set(layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    for name, panel in layout["configById"].items():
        kind = name.split("!")[0]
        assert not unknown(panel, PANEL_KEYS[kind]), name
        for line in panel.get("paths", []):
            assert not unknown(line, LINE), name
    placed = re.findall(r'"([^"]+![^"]+)"', json.dumps(layout["layout"]))
    assert sorted(placed) == sorted(layout["configById"])


def test_foxglove_knows_every_setting_of_the_scene() -> None:
    scene = foxglove()["configById"]["3D!cell"]
    assert not unknown(scene["cameraState"], CAMERA)
    assert not unknown(scene["scene"], SCENE)
    assert not unknown(scene["scene"]["transforms"], TRANSFORMS)
    for topic, settings in scene["topics"].items():
        assert not unknown(settings, TOPIC_KEYS[SHOWN[topic]]), topic
    for layer in scene["layers"].values():
        # a layer foxglove.Urdf reads an address alone there: the description comes by its topic
        assert layer["layerId"] == "foxglove.Grid"
        assert not unknown(layer, GRID)
    assert {topic for topic, settings in scene["topics"].items() if settings["visible"]} >= {
        "/robot_description",
        "/part/sheet",
        "/contour/path",
    }


def test_foxglove_plots_by_the_time_of_the_bag() -> None:
    """In lockstep the stamps of tools and force control begin at 0: by them a curve is decades left of the playhead."""
    lines = [line for panel in foxglove()["configById"].values() for line in panel.get("paths", [])]
    assert len(lines) == 15
    assert {line["timestampMethod"] for line in lines} == {"receiveTime"}


def test_plotjuggler_takes_the_layout_without_asking() -> None:
    """MainWindow::loadLayoutFromFile of PlotJuggler 3 asks whether to go on with any other version."""
    root = ElementTree.parse(LAYOUTS / "cell_plotjuggler.xml").getroot()
    assert root.tag == "root"
    assert root.attrib == {"version": "2.3.8"}
    tabs = root.findall("tabbed_widget/Tab")
    assert len(tabs) == 4
    for splitter in root.iter("DockSplitter"):
        shares = splitter.attrib["sizes"].split(";")
        assert len(shares) == int(splitter.attrib["count"]) == len(splitter.findall("DockArea"))
    assert {plot.attrib["mode"] for plot in root.iter("plot")} == {"TimeSeries"}


def test_rviz_shows_the_frames_that_are_named_and_no_others() -> None:
    """TFDisplay::createFrame enables every frame that is not said to be off, whatever "All Enabled" says."""
    layout = yaml.safe_load((LAYOUTS / "cell.rviz").read_text(encoding="utf-8"))
    displays = {display["Class"]: display for display in layout["Visualization Manager"]["Displays"]}
    frames = displays["rviz_default_plugins/TF"]
    named = {name for name in frames["Frames"] if name != "All Enabled"}
    assert named == {"sheet", "clamp", "tool_1", "tool_2", "tool_1_cell", "tool_2_cell"}
    wanted = re.compile(frames["Filter (whitelist)"])
    links = {link.name for link in describe(load_rig("torrao2013"), None).links}
    links |= {link.name for link in describe(load_rig("ren2018"), None).links}
    assert {name for name in links if wanted.search(name)} == named
    assert wanted.search("cell_1/tool_1")
    assert len(links) > 25
