"""
Motion models
=============

The same push at several speeds, with and without inertia. The quasi-static model leaves inertia
out. That is right while the push is slow.
"""

import matplotlib.pyplot as plt
import numpy as np

import fixel
from fixel.units import deg, mm

speeds = np.geomspace(0.01, 1.0, 9)  # m/s
ends = {"dynamic": [], "quasistatic": [], "first-order": []}
for speed in speeds:
    square = fixel.Polygon.rectangle(100 * mm, 100 * mm)
    support = fixel.Tripod(radius=38 * mm, friction=0.25)
    part = fixel.Body("part", square, mass=0.15, support=support)
    drive = fixel.LineDrive(speed=speed, travel=40 * mm)
    start = (-55 * mm, 20 * mm, 0)
    finger = fixel.Pusher("finger", fixel.Disk(5 * mm), pose=start, drive=drive, friction=0.3)
    scene = fixel.Scene(part, finger, duration=40 * mm / speed + 0.5)
    for motion, turned in ends.items():
        turned.append(fixel.simulate(scene, motion=motion).final["part"].theta / deg)

# %%
fig, axes = plt.subplots(figsize=(5, 3), layout="constrained")
for (motion, turned), marker in zip(ends.items(), "os^", strict=True):
    axes.semilogx(speeds, turned, marker=marker, label=motion)
axes.set(xlabel="speed of the finger [m/s]", ylabel="rotation [deg]")
axes.legend(frameon=False)
