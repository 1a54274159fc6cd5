"""
Pushes that cannot be repeated
==============================

Some pushes make small errors of the start smaller, others let them grow. This part slips past a
peg on one side or on the other.
"""

import fixel
from fixel.units import deg, mm

scene = fixel.load_scene("../scenes/peg_slip.yaml").scene
start = fixel.StartError(x=0.5 * mm, y=0.5 * mm, theta=1 * deg)
found = fixel.sensitivity(scene, start, samples=500)
found

# %%
found.plot()
