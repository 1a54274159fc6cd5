"""
A part never pushed
===================

Four parts were pushed on a board. A fifth arrives. What can be said about its first push, which
pushes should be made first, and what have they taught?
"""

import fixel
from fixel.testing.pushes import example_parts

pushes = fixel.Experiments.of(example_parts(5, 24))
known, new = pushes.where("part!=part-5"), pushes.where("part=part-5")
model = fixel.part_model(known)
model

# %%
# The first lines of a prediction name what no experiment has; two bounds follow.

print(model.at(new[20]))

# %%
# The pushes that reduce the expected error of all candidates most:

candidates = fixel.push_candidates(new[0].scene, travel=0.04)
first = model.next_pushes(candidates, n=4, part="part-5", surface="board")
print(first)

# %%
first.plot()

# %%
# After ten pushes of the part the bounds are narrower:

mine = model.after(new[:10])
print(mine.at(new[20]))

# %%
mine.plot()
