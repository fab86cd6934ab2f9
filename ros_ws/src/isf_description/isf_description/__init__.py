"""The cell as viewers see it: a tree of links and joints made from rig and job, as URDF, frames and joint states."""
