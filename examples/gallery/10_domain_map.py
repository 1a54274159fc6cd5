"""
Where the calibration can be trusted
====================================

Held-out errors of forty pushes, by the surface and by the place where the tip touches the part. A
cell is trusted if nine of ten new pushes stay within the threshold. So few pushes leave doubts.
"""

import fixel
from fixel.units import mm

pushes = fixel.datasets.example()
fit = fixel.calibrate(pushes, ["mu_pusher", "tripod_radius"], motion="quasistatic", verdicts=False)
domain = fixel.map_domain(pushes, fit, threshold=1 * mm)
domain

# %%
domain.plot()
