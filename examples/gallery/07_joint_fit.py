"""
One fit for many pushes, judged on others
=========================================

Six pushes are calibrated together. The two others show how well the parameters predict.
"""

import fixel
from fixel.units import mm

pushes = fixel.read_experiments("../data/pushes.csv", split_by="push", scene="../data/bench.yaml")
train, test = pushes.split(test=2)
space = {"mu_pusher": (0, 1), "tripod_radius": (10 * mm, 60 * mm)}
fit = fixel.calibrate(train, space, motion="quasistatic", verdicts=False)

comparison = fixel.compare(pushes, fit)
comparison

# %%
comparison.plot()

# %%
# Measured and simulated motion of one of the others.
fixel.compare(test[0], fit).plot("motion")
