"""
Noise and repetitions
=====================

More pushes make intervals narrower: the noise of measurements averages out, and every push touches
the box at another place. With one push the support is hardly known.
"""

import matplotlib.pyplot as plt

import fixel
from fixel.units import deg, mm

pushes = fixel.read_experiments("../data/pushes.csv", split_by="push", scene="../data/bench.yaml")
noise = fixel.Noise(position_m=0.2 * mm, angle_rad=0.18 * deg)
space = {"mu_pusher": (0, 1), "tripod_radius": (10 * mm, 60 * mm)}
numbers = (1, 2, 4, 8)
radius = [
    fixel.calibrate(pushes[:n], space, noise=noise, motion="quasistatic").estimates["tripod_radius"]
    for n in numbers
]

# %%
fig, axes = plt.subplots(figsize=(5, 3), layout="constrained")
value = [one.value / mm for one in radius]
low = [(one.value - one.low) / mm for one in radius]
high = [(one.high - one.value) / mm for one in radius]
axes.errorbar(numbers, value, (low, high), fmt="o", capsize=4, label="95 % interval")
axes.axhline(41, color="k", lw=1, ls="--", label="truth")
axes.set(xlabel="pushes", ylabel="tripod radius [mm]", xscale="log")
axes.set_xticks(numbers, map(str, numbers))
axes.minorticks_off()
axes.legend(frameon=False)
