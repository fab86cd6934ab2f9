"""From the points of a scanner to the formed shape in the frame of the clamp: checks, registration, sections."""

from isf_springback.scan.formed_shape import FormedShape, ScanExpectation, process_scan

__all__ = ["FormedShape", "ScanExpectation", "process_scan"]
