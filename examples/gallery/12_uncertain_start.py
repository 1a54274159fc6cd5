"""
A grasp with an uncertain start
===============================

A square is pushed against three fixels. How probable is it that it ends seated on two of them, if
its start is known within 2 mm and 3 degrees?
"""

import fixel
from fixel.units import deg, mm

scene = fixel.load_scene("../scenes/grasp.yaml").scene
start = fixel.StartError(x=2 * mm, y=2 * mm, theta=3 * deg)
ends = fixel.predict(scene, start=start, samples=1000)
seated = fixel.Seated("fixel-1", "fixel-2")
print(ends.probability(seated))
ends

# %%
ends.plot()
