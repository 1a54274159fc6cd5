"""
How a part rests on the table
=============================

The same push of a part that rests on three points, on its whole face, or as an ellipsoidal limit
surface. The pressure decides how far it turns. It cannot be seen, so calibration estimates it.
"""

import matplotlib.pyplot as plt

import fixel
from fixel.units import deg, mm

supports = {
    "tripod, 20 mm": fixel.Tripod(radius=20 * mm, friction=0.25),
    "tripod, 50 mm": fixel.Tripod(radius=50 * mm, friction=0.25),
    "even pressure": fixel.UniformPressure(friction=0.25),
    "ellipsoid": fixel.Ellipsoid(force=0.37, torque=0.37 * 38 * mm),
}
turned = {}
for name, support in supports.items():
    square = fixel.Polygon.rectangle(100 * mm, 100 * mm)
    part = fixel.Body("part", square, mass=0.15, support=support)
    drive = fixel.LineDrive(speed=20 * mm)
    start = (-55 * mm, 20 * mm, 0)
    finger = fixel.Pusher("finger", fixel.Disk(5 * mm), pose=start, drive=drive, friction=0.3)
    push = fixel.simulate(fixel.Scene(part, finger, duration=2.0), motion="quasistatic")
    turned[name] = push.final["part"].theta / deg

# %%
fig, axes = plt.subplots(figsize=(5, 2.2), layout="constrained")
bars = axes.barh(list(turned), list(turned.values()))
axes.bar_label(bars, fmt="%.1f", padding=3)
axes.invert_yaxis()
axes.set(xlabel="rotation [deg]", xlim=(min(turned.values()) * 1.15, 0))
