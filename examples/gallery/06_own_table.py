"""
Calibrate a table of your own
=============================

A table with the measured poses of a box and the path of the tip that pushes it becomes friction
and support with intervals, and a verdict on each.
"""

import fixel
from fixel.units import mm

pushes = fixel.read_experiments("../data/pushes.csv", split_by="push", scene="../data/bench.yaml")
fit = fixel.calibrate(
    pushes, {"mu_pusher": (0, 1), "tripod_radius": (10 * mm, 60 * mm)}, motion="quasistatic"
)
fit

# %%
# The pushes were simulated with a friction of 0.22 and a radius of 41 mm, and with noise.
print("identified:", fit.identified)
fit.plot()
