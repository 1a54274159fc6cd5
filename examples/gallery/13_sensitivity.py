"""
Pushes that cannot be repeated
==============================

Some pushes make errors of the start smaller, others let them grow. Where starts side by side end
far apart, a push cannot be repeated, and no calibration helps.
"""

import fixel
from fixel.units import deg, mm

start = fixel.StartError(x=10 * mm, y=10 * mm, theta=15 * deg, kind="uniform")
found = fixel.sensitivity("../scenes/grasp.yaml", start, samples=500, indices=True, base=512)
found

# %%
# Sobol indices: the share of the variance of the end that each error of the start causes.
found.plot("indices")
