"""Plans to files and back: own plan file, tables, machine programs."""

from isf_planner.exports.plan_file import load_plan, save_plan
from isf_planner.exports.post_processor import load_post, post_names
from isf_planner.exports.programs import read_programs, write_programs
from isf_planner.exports.stage_files import check_stages, export_stages
from isf_planner.exports.writer import FORMATS, check_export, export, for_arms, format_of

__all__ = [
    "FORMATS",
    "check_export",
    "check_stages",
    "export",
    "export_stages",
    "for_arms",
    "format_of",
    "load_plan",
    "load_post",
    "post_names",
    "read_programs",
    "save_plan",
    "write_programs",
]
