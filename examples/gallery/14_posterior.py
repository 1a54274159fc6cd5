"""
Posterior
=========

Nested sampling gives the probability distribution of the parameters, with all their relations.
"""

import fixel
from fixel.units import deg, mm

pushes = fixel.read_experiments("../data/pushes.csv", split_by="push", scene="../data/bench.yaml")
space = {"mu_pusher": (0, 1), "tripod_radius": (10 * mm, 60 * mm)}
noise = fixel.Noise(position_m=0.2 * mm, angle_rad=0.18 * deg)
posterior = fixel.posterior(pushes[:2], space, noise=noise, samples=500, motion="quasistatic")
posterior

# %%
posterior.plot()
