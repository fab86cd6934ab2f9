"""Springback correction of every contour before it is formed: sheet models and force forecast."""

from isf_springback.method import METHODS, CorrectionMethod, apply, check_method, check_name, make_method

__all__ = ["METHODS", "CorrectionMethod", "apply", "check_method", "check_name", "make_method"]
