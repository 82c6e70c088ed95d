"""How far one gets: minutes on foot to every place around a camp, and a robot's reach with a battery.

`reach` gives the cost of the cheapest path to each cell, in the unit of the step cost: seconds by Tobler's hiking
function, joules by a vehicle's model. Uphill and downhill differ, so the way out and the way back do, too.

Run time: 5 s.
Data: earth_hummocks, airborne lidar with cells of 1 m, MIT licence (nnpp_edge/terrain/samples/README.md).
"""

from pathlib import Path

import numpy as np
from drawing import panels, relief, run, save

from nnpp_edge.runtime import EnergyCost, Mobility, Planner
from nnpp_edge.terrain.shipped import sample_dem

CAMP = (130, 90)
ROBOT = Mobility(energy=EnergyCost(mass_kg=40.0, rolling_resistance=0.1, efficiency=0.6, recovery=0.3))


def main(folder: Path, small: bool = False) -> Path:
    """Draw lines of equal time and of equal energy."""
    dem = sample_dem("earth_hummocks")
    ground = {"dem": dem.elevation, "cell_size_m": dem.cell_size_m, "warn": False}
    seconds = Planner.of_elevation(**ground, step_cost="tobler").reach(CAMP)
    joules = Planner.of_elevation(**ground, step_cost="energy", mobility=ROBOT).reach(CAMP, within=12_000.0)

    print(f"{np.mean(seconds <= 120):.0%} of the map is within two minutes on foot")
    print(f"{np.isfinite(joules).mean():.0%} of it is within 12 kJ of the robot's battery")
    figure, axes = panels(2, width=4.6)
    fields = [(seconds / 60, "minutes on foot (Tobler)"), (joules / 1000, "kJ of a 40 kg robot, up to 12")]
    for panel, (field, title) in zip(axes, fields, strict=True):
        relief(panel, dem, title)
        shown = np.where(np.isfinite(field), field, np.nan)
        panel.imshow(shown, cmap="viridis_r", alpha=0.45)
        lines = panel.contour(shown, levels=6, colors="black", linewidths=0.8)
        panel.clabel(lines, fontsize=8)
        panel.plot(CAMP[1], CAMP[0], "s", color="gold", markeredgecolor="black")
    return save(figure, folder, "reach")


if __name__ == "__main__":
    run(main)
