"""
Follow a part that the camera loses
===================================

A particle filter estimates the pose and the friction while a push runs. The camera sees nothing
between 1.0 s and 2.0 s.
"""

import fixel

pushes = fixel.read_experiments("../data/pushes.csv", split_by="push", scene="../data/bench.yaml")
run = fixel.filter(pushes[0], particles=200, occlusion=(1.0, 2.0))
run

# %%
run.plot()
