"""
From a camera to an experiment
==============================

A recording of a camera becomes an experiment with a scene. Here the recording is rendered from a
simulation, so the true motion is known.
"""

import subprocess
import tempfile

import fixel

recording = f"{tempfile.mkdtemp()}/push"
command = "fixel testbed film ../scenes/grasp.yaml --rate 10 --frames 60 --out"
subprocess.run([*command.split(), recording], check=True)
experiments = fixel.read_experiments(recording)  # finds the tags in every frame
experiments

# %%
experiments[0].plot()
