"""
A bound on the error of an untried push
=======================================

A conformal bound: the error of a new push like those measured stays below it in 90 % of the cases.
"""

import fixel
from fixel.units import mm

pushes = fixel.datasets.example()
fit = fixel.calibrate(pushes, ["mu_pusher", "tripod_radius"], motion="quasistatic", verdicts=False)
bound = fixel.error_bound(pushes, fit, level=0.9)
bound

# %%
print(f"{bound.at(pushes[0].scene).position / mm:.1f} mm")
bound.plot()
