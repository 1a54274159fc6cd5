"""
Replay measured pushes
======================

Each measured path of the tip drives a simulation. Its end is compared with the measured end, for
two guesses of the parameters.
"""

import fixel
from fixel.units import mm

pushes = fixel.read_experiments("../data/pushes.csv", split_by="push", scene="../data/bench.yaml")
models = {
    "slippery": {"mu_pusher": 0.05, "tripod_radius": 30 * mm},
    "rough": {"mu_pusher": 0.50, "tripod_radius": 30 * mm},
}
replay = fixel.compare(pushes, models, motion="quasistatic")
replay

# %%
replay.plot()
