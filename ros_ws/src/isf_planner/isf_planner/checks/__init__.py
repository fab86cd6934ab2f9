"""Can the part be formed on this rig, with these tools, over this die?"""
