"""
Profile of a trade-off
======================

In slow pushing only the ratio of some parameters matters. Here the friction under the part has no
effect at all: its profile is flat, and the verdict says so.
"""

import fixel
from fixel.units import mm

pushes = fixel.read_experiments("../data/pushes.csv", split_by="push", scene="../data/bench.yaml")
space = {"mu_pusher": (0, 1), "tripod_radius": (10 * mm, 60 * mm), "mu_support": (0.05, 1)}
fit = fixel.calibrate(pushes[:2], space, motion="quasistatic")
for name, estimate in fit.estimates.items():
    print(f"{name}: {estimate.verdict} - {estimate.reason}")

# %%
fit.plot("profiles")
