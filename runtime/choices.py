"""What a user chooses by name, with what the page and the help say of it.

Commands, the page, profiles and documents read these tables. They import nothing, so that `--help`
is instant.
"""

METHODS = {
    "auto": "picks one by measured figures, and says why",
    "astar": "exact, over the whole map",
    "corridor": "coarse to fine, without learning",
    "nnpp": "inside the network's region (the paper)",
}
"""Ways of planning, `planners.plan.Method`."""
REPAIRING_METHODS = {
    "dstar": "D* Lite over the whole map: exact, repaired from step to step",
    "corridor-dstar": "D* Lite in the corridor",
    "nnpp-dstar": "D* Lite in the network's region (the paper's D*NN)",
}
"""The others on a map that changes, `planners.plan.DynamicMethod`."""
STEP_COSTS = {
    "paper": "ground (paper)",
    "tobler": "time on foot (Tobler)",
    "irmischer": "time on foot, off paths (Irmischer)",
    "linear": "slope (linear)",
    "time": "vehicle's time",
    "energy": "vehicle's energy",
}
"""What a step costs on a map of heights; those by the slope are `robots.slope.cost.SLOPE_COSTS`."""
