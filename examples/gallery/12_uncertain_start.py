"""
A grasp with an uncertain start
===============================

A square is pushed against three fixels. How probable is it that it ends seated on two of them, if
its start is known only within 10 mm and 15 degrees?
"""

import fixel
from fixel.units import deg, mm

start = fixel.StartError(x=10 * mm, y=10 * mm, theta=15 * deg, kind="uniform")
ends = fixel.predict("../scenes/grasp.yaml", start=start, samples=1000)
seated = fixel.Seated("fixel-1", "fixel-2")
print(ends.probability(seated))
ends

# %%
ends.plot()
