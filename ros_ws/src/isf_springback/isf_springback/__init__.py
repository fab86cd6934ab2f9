"""Springback: every contour corrected before it is formed, by one of several methods within common limits."""

from isf_springback.corrector import Corrector, apply
from isf_springback.methods import check_method, check_name, make_corrector, method_names

__all__ = ["Corrector", "apply", "check_method", "check_name", "make_corrector", "method_names"]
