"""
Jam
===

A rigid pusher squeezes a part against two fixels. Nothing can give way, so the simulation stops
with the status ``jammed``. With a limit of its force the drive stalls instead, and the part rests.
"""

import fixel
from fixel.units import mm


def grasp(force_limit):
    part = fixel.Body(
        "part",
        fixel.Polygon.rectangle(80 * mm, 80 * mm),
        mass=0.15,
        support=fixel.Tripod(radius=30 * mm, friction=0.25),
    )
    drive = fixel.LineDrive(speed=20 * mm, force_limit=force_limit)
    head = fixel.Polygon.rectangle(20 * mm, 30 * mm)
    start = (-60 * mm, 5 * mm, 0)
    pusher = fixel.Pusher("pusher", head, pose=start, drive=drive, friction=0.3)
    pegs = [
        fixel.Fixel(f"fixel-{k}", fixel.Disk(5 * mm), pose=(60 * mm, y, 0), friction=0.2)
        for k, y in ((1, -25 * mm), (2, 25 * mm))
    ]
    return fixel.Scene(part, pusher, pegs, duration=3.0)


jammed = fixel.simulate(grasp(None))
jammed

# %%
seated = fixel.simulate(grasp(20.0))  # N
print(seated.status, seated.touching)
seated.plot()
