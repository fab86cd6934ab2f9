"""Published laws of the process: forces, thickness, places of the tools, deflection."""
